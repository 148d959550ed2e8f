"""The readers of msb.bench and msb.report as fuzz targets."""

from __future__ import annotations

from fuzz import readers, run_folder, seeds
from fuzz.target import Target

RESULT = "cells/capture/desk/two_dts/dedicated/result.json"

TARGETS: dict[str, Target] = {
    "protocol": Target(readers.protocol, seeds.protocols, "protocol.toml"),
    "result": Target(readers.report, seeds.results, RESULT),
    "submission": Target(readers.submission, seeds.submissions, "a.zip"),
    "submission_record": Target(readers.submission, seeds.results, "a.zip", wrap=seeds.around_record),
    **run_folder.targets(),
    "renderer_timing": Target(readers.renderer_timing, seeds.renderer_timings, "timing.json"),
    "track": Target(readers.track, seeds.tracks, "track.json"),
    "published": Target(readers.published, seeds.published, "published.json"),
    "benchmark": Target(readers.benchmark, seeds.benchmarks, "bench.json"),
}
