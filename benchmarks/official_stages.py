"""The measurements of `benchmarks.official`. There is a function per stage, called in a separate process.

Each stage opens the checkpoint again. Its peak memory is therefore independent of other stages, and a
crashing driver ends one stage only. A stage returns only numbers, and names of methods, devices and metrics.
If an error occurs, it returns only the error code, because messages contain file names.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

import msb
from benchmarks import measure
from msb.adapters.locate import locate
from msb.asset.settings import effective_settings
from msb.bench.nvml import Gpus
from msb.bench.profile import profile
from msb.bench.renders import Renders, check_size, find_renders
from msb.cl.devices import KINDS
from msb.errors import InputError, MsbError
from msb.metrics import psnr, read_image
from msb.metrics.ground_truth import ground_truth
from msb.metrics.registry import mean_of
from msb.render import Renderer
from msb.render.backend import minimal_options
from msb.render.images import to_bytes
from msb.render.machine import machine
from msb.scenes.datasets import (
    DATASETS,
    compare_training,
    default_background,
    scene_of,
    stated_background,
)
from msb.views import choose_views, spread_evenly
from msb.why import why

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.registry import Tier
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

SIZE = 1237, 822
"""Image size (width, height) that is used without a capture.

It is a quarter of the resolution of Mip-NeRF 360's garden.
"""
_WHY_VIEWS, _WHY_LONGEST = 12, 640
"""Number and size of the views that `msb why` generates by default."""
_TIMED, _FEWEST, _LONG = 100, 10, 60.0
"""Largest and smallest number of timed frames.

If the largest number would take more than a minute, fewer frames are timed.
"""
_CUT_OFF = ("diffsoup",)
"""Methods whose official evaluation truncates colours to bytes, as the code in `kenji-tojo/diffsoup` does."""
_OF_DEVICE = "platform", "name", "vendor", "driver", "version", "kind", "compute_units"


@dataclass(frozen=True)
class Given:
    """The user's input.

    The request has absolute paths, a device selector, and the folder and resolution of the photographs.
    """

    checkpoint: str
    scene: str | None = None
    device: str | None = None
    image_folder: str | None = None
    resolution: int | None = None

    def capture(self, asset: Asset) -> Scene | None:
        """Return the scene with the evaluation rules of the model's method."""
        if self.scene is None:
            return None
        photographs: dict[str, Any] = {"image_folder": self.image_folder, "resolution": self.resolution}
        return scene_of(asset.manifest, self.scene, **photographs)

    def renders(self, scene: Scene) -> Renders:
        """Return the paths of the latest official renderings of the test views."""
        root = locate(self.checkpoint).root
        found = {
            int(number[1]): folder / "renders"
            for folder in (root / "test").glob("ours_*")
            if (number := re.fullmatch(r"ours_(\d{1,9})", folder.name)) and (folder / "renders").is_dir()
        }
        if not found:
            text = "official renderings are missing; expected them in test/ours_N/renders"
            raise InputError("FILE_NOT_FOUND", text, file=root)
        return find_renders(found[max(found)], scene.test)


def stage_machine(given: Given) -> dict[str, Any]:
    """Return the machine, the devices and the versions of packages."""
    try:
        found = machine(given.device)["device"]
        device = {key: found[key] for key in _OF_DEVICE}
    except MsbError as error:
        device = {"failed": error.code}
    gpus = Gpus()
    return {
        "system": platform.platform(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
        **measure.machine("numpy", "pyopencl", "wgpu"),
        "opencl": device,
        "nvidia": [{"name": one.name, "total_bytes": one.total_bytes} for one in gpus.devices()],
        "nvml": gpus.result()[2] or "there",
    }


def stage_export(given: Given) -> dict[str, Any]:
    """Export the checkpoint to a temporary file; return its size and contents in numbers."""
    start = time.perf_counter()
    asset = msb.open(given.checkpoint)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "official.triasset")
        msb.save(asset, place)
        seconds, size = time.perf_counter() - start, place.stat().st_size
    manifest = asset.manifest
    numbers = {
        key: value for key, value in effective_settings(manifest).items() if isinstance(value, int | float)
    }
    return {
        "method": manifest.method,
        "faces": manifest.face_count,
        "vertices": manifest.vertex_count,
        "settings": numbers,
        "seconds": seconds,
        "bytes": size,
    }


def stage_capture(given: Given) -> dict[str, Any]:
    """Return the scene's name if it is known, its views, and differences from the official training."""
    asset = msb.open(given.checkpoint)
    scene = given.capture(asset)
    assert scene is not None
    known = DATASETS.get(scene.dataset)
    own = stated_background(asset.manifest)
    return {
        "dataset": scene.dataset if known else "custom",
        "scene": scene.name if known and scene.name in known.scenes else None,
        "train": len(scene.train),
        "test": len(scene.test),
        "sizes": _sizes(scene.test),
        "trained_otherwise": [note.message for note in compare_training(asset.manifest.training, own, scene)],
    }


def stage_audit(given: Given) -> dict[str, Any]:
    """Audit the mesh as it is stored."""
    asset = msb.open(given.checkpoint)
    start = time.perf_counter()
    found = msb.audit(asset).to_dict()
    return {
        "seconds": time.perf_counter() - start,
        "verdict": found["verdict"]["level"],
        "counts": found["counts"],
        "metrics": found["metrics"],
    }


def stage_official(given: Given) -> dict[str, Any]:
    """Return the PSNR of the official renderings against the photographs."""
    scene = given.capture(msb.open(given.checkpoint))
    assert scene is not None
    theirs = _read(given.renders(scene), scene)
    values = [psnr(theirs(number), ground_truth(scene, one)) for number, one in enumerate(scene.test)]
    return {"views": len(values), "psnr": mean_of(values)}


def stage_draw(given: Given, tier: Tier, renderer: str | None = None) -> dict[str, Any]:
    """Return frame times, memory and PSNR of a tier over the test views."""
    asset = msb.open(given.checkpoint)
    scene = given.capture(asset)
    if scene is None:
        cameras: Sequence[Camera] = choose_views(asset, size=SIZE, device=given.device).cameras
        background = default_background(asset.manifest)
    else:
        cameras, background = scene.test, scene.background
    gpus, start = Gpus(), time.perf_counter()
    options = minimal_options(tier, renderer)
    # Engines accept only a kind of device ("cpu", "gpu"), not the name of an OpenCL platform.
    selector = given.device if renderer is None or given.device in KINDS else None
    with Renderer(asset, tier, selector, name=renderer, **options) as drawing:
        device = _device(given, drawing.device_info)
        drawing.draw(cameras[0], background)
        first = time.perf_counter() - start
        again = time.perf_counter()
        drawing.draw(cameras[0], background)
        frames = int(_LONG / max(time.perf_counter() - again, 1e-6))
        timed = profile(drawing, cameras, background, frames=min(max(frames, _FEWEST), _TIMED)).to_dict()
        held = gpu_memory(gpus, device["kind"])
        near = {} if scene is None else _decibels(given, drawing, scene, asset.manifest.method)
        name = drawing.name
    return {
        "renderer": name,
        "device": device,
        "views": len(cameras),
        "sizes": _sizes(cameras),
        "first_frame_seconds": first,
        **{key: timed[key] for key in ("frames", "fps", "device_ms", "busy_ms", "stages_ms")},
        "memory_bytes": sum(timed["memory_bytes"].values()),
        "gpu_memory": held,
        **({"psnr": near} if near else {}),
    }


def gpu_memory(gpus: Gpus, kind: str) -> dict[str, Any]:
    """Return the GPU memory that this process has allocated since `gpus` was created, or the reason why it is
    unknown. NVML measures it.
    """
    if kind != "gpu":
        return {"bytes": None, "source": None, "reason": "the device is not a GPU"}
    gpus.look({os.getpid()})
    held, source, reason = gpus.result()
    if not held:
        return {
            "bytes": None,
            "source": None,
            "reason": reason or "NVML does not list memory of this process",
        }
    return {"bytes": held, "source": source, "reason": None}


def _device(given: Given, engine: Mapping[str, str] | None) -> dict[str, Any]:
    found = machine(given.device, engine=engine)["device"]
    return {key: found[key] for key in _OF_DEVICE if key in found}


def _sizes(cameras: Sequence[Camera]) -> list[str]:
    return sorted({f"{one.width}x{one.height}" for one in cameras})


def _read(renders: Renders, scene: Scene) -> Callable[[int], NDArray[Any]]:
    """Return a function that reads the official rendering of test view number n."""

    def read(number: int) -> NDArray[Any]:
        file = renders.files[number]
        image = read_image(file, background=scene.background)
        check_size(file, (image.shape[1], image.shape[0]), scene.test[number])
        return image

    return read


def _decibels(given: Given, drawing: Renderer, scene: Scene, method: str) -> dict[str, float | None]:
    """Return the mean PSNR of the test views against the photographs and against the official renderings."""
    theirs: Callable[[int], NDArray[Any]] | None = None
    with contextlib.suppress(MsbError):  # the stage "official" reports why they are missing
        theirs = _read(given.renders(scene), scene)
        theirs(0)
    photographs, official = [], []
    for number, camera in enumerate(scene.test):
        image = drawing.render(camera, scene.background).image
        photographs.append(psnr(to_bytes(image), ground_truth(scene, camera)))
        if theirs is not None:
            saved = np.uint8(255 * image.clip(0, 1)) if method in _CUT_OFF else to_bytes(image)
            official.append(psnr(saved, theirs(number)))
    return {"photographs": mean_of(photographs), "official": mean_of(official)}


def stage_why(given: Given) -> dict[str, Any]:
    """Return the loss in dB of each cause, the largest first, and the loss of all causes together."""
    asset = msb.open(given.checkpoint)
    scene = given.capture(asset)
    views = None
    if scene is not None:
        few = spread_evenly(scene.test, _WHY_VIEWS)
        views = [one.scaled(min(1.0, _WHY_LONGEST / max(one.width, one.height))) for one in few]
    start = time.perf_counter()
    background = None if scene is None else scene.background
    causes = why(asset, views, background=background, device=given.device)
    costs = [(cause.db, cause.to_dict()) for cause in causes if cause.db is not None]
    total = causes.total.to_dict()
    return {
        "seconds": time.perf_counter() - start,
        "costs": [
            {key: one[key] for key in ("name", "db", "equal")}
            for _, one in sorted(costs, key=lambda pair: pair[0])
        ],
        "total": {key: total[key] for key in ("db", "equal", "engine_settings", "bake")},
    }


def stage_bake(given: Given) -> dict[str, Any]:
    """Bake with `geometry="kept"`, which needs no optimisation. Return the PSNR before and after."""
    asset = msb.open(given.checkpoint)
    baked = msb.bake(asset, scene=given.capture(asset), geometry="kept", device=given.device)
    with tempfile.TemporaryDirectory() as folder:
        report = baked.save(Path(folder, "official.glb"))
    found = report.to_dict()
    keys = "geometry", "color", "faces", "texture", "bytes", "seconds", "psnr", "unseen_area"
    return {
        **{key: found[key] for key in keys},
        "views": {key: found["views"][key] for key in ("training", "validation", "test")},
        "verdict": {key: found[f"verdict_{key}"]["level"] for key in ("before", "after")},
    }


STAGES: dict[str, Callable[[Given], dict[str, Any]]] = {
    "machine": stage_machine,
    "export": stage_export,
    "capture": stage_capture,
    "audit": stage_audit,
    "official": stage_official,
    "standard": partial(stage_draw, tier="standard"),
    "dedicated": partial(stage_draw, tier="dedicated"),
    "standard/wgpu": partial(stage_draw, tier="standard", renderer="wgpu"),
    "dedicated/wgpu": partial(stage_draw, tier="dedicated", renderer="wgpu"),
    "why": stage_why,
    "bake": stage_bake,
}
"""All stages, in the order in which they run."""


def work(word: str, _: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run the stage named in the JSON text `word`. Child processes call this function.

    A failed stage returns the error code. `said` has the full message, which is printed but not stored.
    """
    stage, about = json.loads(word)
    try:
        found = STAGES[stage](Given(**about))
    except MsbError as error:
        return {"failed": error.code, "said": str(error)}, {}
    peak = {} if stage in ("machine", "capture") else {"peak_memory_bytes": measure.peak()}
    return {**found, **peak}, {}


def asked(stage: str, given: Given) -> str:
    """Return the JSON text with which `work` runs a stage."""
    return json.dumps([stage, asdict(given)])
