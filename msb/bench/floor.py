"""What a renderer takes for one triangle: its images, tables and lists, whatever the mesh is."""

import contextlib
from dataclasses import fields
from typing import Any, Literal

import numpy as np

from msb.asset import Asset
from msb.asset.build import Description, build_asset
from msb.bench.digest import digest
from msb.bench.job import Job
from msb.bench.profile import profile
from msb.bench.quality import open_renderer, renderer_info
from msb.bench.records import Floor
from msb.errors import MsbError
from msb.scenes.datasets import Scene

_FRAMES = 20
# Hash of all that a floor depends on -> the floor, measured once for a process.
_known: dict[str, Floor | None] = {}


def measure_floor(job: Job, scene: Scene, kind: Literal["gpu", "cpu", "other"]) -> Floor | None:
    """Return what the job's renderer takes for one triangle of its model at the size of the largest view.

    None where it cannot draw a single triangle.
    """
    camera = max(scene.test, key=lambda one: one.width * one.height)
    size, cell = (camera.width, camera.height), job.cell
    of = [
        cell.condition_key,
        cell.renderer,
        cell.method,
        renderer_info(job, "").settings,
        size,
        str(job.device),
    ]
    key = digest(of)
    if key not in _known:
        _known[key] = None
        with contextlib.suppress(MsbError):
            assert job.model is not None
            with open_renderer(job, one_triangle(job.model.open())) as renderer:
                drawn = profile(
                    renderer,
                    [camera],
                    scene.background,
                    frames=min(job.timing.frames, _FRAMES),
                    seconds=0,
                    device_kind=kind,
                )
            _known[key] = Floor(
                width=size[0],
                height=size[1],
                p50_ms=drawn.timing.p50_ms,
                p95_ms=drawn.timing.p95_ms,
                memory_bytes=sum(drawn.memory.values()),
            )
    return _known[key]


def one_triangle(asset: Asset) -> Asset:
    """Return an asset of the first triangle of `asset`, with all that it and its corners hold."""
    manifest = asset.manifest
    rows: dict[str, Any] = {
        "vertex": asset.buffers["indices"][0],
        "face": [0],
        "corner": [0, 1, 2],
        "global": ...,
    }
    domains = {name: spec.domain for name, spec in manifest.buffers.items()}
    buffers = {name: array[rows[domains[name]]] for name, array in asset.buffers.items()}
    buffers["indices"] = np.arange(3, dtype=np.uint32)[None]
    kept = {field.name: getattr(manifest, field.name) for field in fields(Description)}
    return build_asset(buffers, domains, Description(**kept))
