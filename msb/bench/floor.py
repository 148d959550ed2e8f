"""The fixed cost of a renderer: time and memory for a single triangle in the test views."""

import contextlib
from typing import Any, Literal

import numpy as np

from msb.asset import Asset
from msb.asset.build import Description, build_asset
from msb.bench.digest import digest
from msb.bench.job import Job
from msb.bench.profile import profile
from msb.bench.quality import describe_renderer, open_renderer
from msb.bench.records import Floor
from msb.errors import MsbError
from msb.scenes.datasets import Scene

# Maximum number of timed frames of a single triangle. The time for a single triangle hardly varies, so 20
# frames are enough.
_FRAMES = 20
# The measured cost of a single triangle. The key is the hash of the inputs. Renderers with equal inputs are
# measured once per process.
_known: dict[str, Floor | None] = {}


def measure_floor(job: Job, scene: Scene, kind: Literal["gpu", "cpu", "other"]) -> Floor | None:
    """Return time and memory of the renderer for one triangle of the model at the size of the largest view.

    The result is None if the renderer cannot draw a single triangle.
    """
    camera = max(scene.test, key=lambda view: view.width * view.height)
    size, cell = (camera.width, camera.height), job.cell
    settings = describe_renderer(job, "").settings
    key = digest([cell.condition_key, cell.renderer, cell.method, settings, size, str(job.device)])
    if key not in _known:
        _known[key] = None
        with contextlib.suppress(MsbError):
            assert job.model is not None
            with open_renderer(job, take_one_triangle(job.model.open())) as renderer:
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


def take_one_triangle(asset: Asset) -> Asset:
    """Return an asset with only the first triangle of `asset` and all its face and vertex attributes."""
    manifest = asset.manifest
    # In each buffer, select the rows that belong to the triangle.
    rows: dict[str, Any] = {
        "vertex": asset.buffers["indices"][0],
        "face": [0],
        "corner": [0, 1, 2],
        "global": ...,
    }
    domains = {name: spec.domain for name, spec in manifest.buffers.items()}
    buffers = {name: array[rows[domains[name]]] for name, array in asset.buffers.items()}
    buffers["indices"] = np.arange(3, dtype=np.uint32)[None]
    return build_asset(buffers, domains, Description.of(manifest))
