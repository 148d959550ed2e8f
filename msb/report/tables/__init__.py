"""Every table of the report, each made from numbers alone."""

from __future__ import annotations

from msb.report.tables.features import deployment_features, native_features
from msb.report.tables.gaps import gaps_table, slowdown_table
from msb.report.tables.quality import native_summary, per_scene, renderer_comparison, scene_comparison
from msb.report.tables.reproducibility import reproducibility, reproducibility_statistics
from msb.report.tables.runtime import frame_time, latency, memory, runtime_resources
from msb.report.tables.structure import mesh_connectivity

__all__ = [
    "deployment_features",
    "frame_time",
    "gaps_table",
    "latency",
    "memory",
    "mesh_connectivity",
    "native_features",
    "native_summary",
    "per_scene",
    "renderer_comparison",
    "reproducibility",
    "reproducibility_statistics",
    "runtime_resources",
    "scene_comparison",
    "slowdown_table",
]
