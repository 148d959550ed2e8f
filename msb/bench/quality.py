"""The part "quality" of a cell: images rendered or imported, written, and compared with the photographs."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from msb import metrics
from msb.atomic import new_folder
from msb.bench.machine import machine
from msb.bench.photographs import checked_scene
from msb.bench.records import ImageQuality, Quality, RendererInfo, mean_of
from msb.bench.renders import find_renders
from msb.errors import MetricError
from msb.files import file_sha256
from msb.render.images import Writers, image_names, to_bytes, write_image

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from msb.bench.job import Job
    from msb.render import Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

    Pixels = NDArray[np.uint8]

NO_WEIGHTS = "no VGG weights ([metrics] vgg_weights)"


def measure_quality(job: Job) -> dict[str, Any]:
    """Return what a record says of a cell's images: quality, setup, renderer, device, renders.

    Raises
    ------
    MsbError
        Whatever is wrong with scene, asset, renderings or device.
    """
    scene = checked_scene(job.scene, job.views)
    source: _Imported | _Drawn = _Imported(job, scene) if job.renders is not None else _Drawn(job, scene)
    names = image_names(scene.test)
    network = None if job.vgg_weights is None else lpips_network(job.vgg_weights)
    rows: list[ImageQuality] = []
    with new_folder(job.folder / "images") as folder, Writers() as writers:
        for name, camera, image in zip(names, scene.test, source.images(), strict=True):
            writers.submit(write_image, folder / f"{name}.png", image, "png")
            truth = job.photographs / f"{name}.png"
            rows.append(_compare(job, camera, name, to_bytes(image), truth, network))
    rows = [row.model_copy(update={"sha256": file_sha256(job.folder / str(row.file))}) for row in rows]
    return {
        "quality": _summary(rows, network),
        "setup": job.views.setup,
        **source.about(),
    }


@lru_cache(maxsize=1)
def lpips_network(weights: Path) -> metrics.LpipsVgg:
    """Return the network of LPIPS, once for a process."""
    return metrics.LpipsVgg(weights)


def identities(network: metrics.LpipsVgg | None) -> tuple[dict[str, Any], ...]:
    """Return the full identity of every metric that is computed."""
    found = [metrics.identity("psnr"), metrics.identity("ssim")]
    return tuple(one.to_dict() for one in (*found, *([] if network is None else [network.identity()])))


@dataclass
class _Imported:
    """Official renderings."""

    job: Job
    scene: Scene

    def __post_init__(self) -> None:
        assert self.job.renders is not None
        self.found = find_renders(self.job.renders, self.scene.test)

    def images(self) -> Iterator[NDArray[np.float32]]:
        for path, camera in zip(self.found.files, self.scene.test, strict=True):
            image = metrics.read_image(path, background=self.scene.background)
            if image.shape[:2] != (camera.height, camera.width):
                height, width = image.shape[:2]
                text = f"it is {width} x {height}, the photograph {camera.width} x {camera.height}"
                raise MetricError("METRIC_SIZES_DIFFER", text, file=path)
            scale = np.float32(255 if image.dtype == np.uint8 else 1)
            yield np.asarray(image, np.float32) / scale

    def about(self) -> dict[str, Any]:
        info = RendererInfo(
            name=self.job.cell.method,
            version="",
            kind="upstream",
            settings={"matched_by": self.found.matched_by},
        )
        return {"renders": self.found.folder, "renderer": info, "device": None}


@dataclass
class _Drawn:
    """Images of one of our renderers, or of an engine."""

    job: Job
    scene: Scene
    name: str = ""
    engine: Mapping[str, str] | None = None

    def images(self) -> Iterator[NDArray[np.float32]]:
        with open_renderer(self.job) as renderer:
            self.name, self.engine = renderer.name, renderer.device_info
            for camera in self.scene.test:
                yield renderer.render(camera, self.scene.background).image

    def about(self) -> dict[str, Any]:
        host = self.job.tier == "reference"
        return {
            "renderer": renderer_info(self.job, self.name),
            "device": machine(self.job.device, opencl=not host, engine=self.engine),
        }


def open_renderer(job: Job) -> Renderer:
    """Return the cell's renderer, which computes no more than an image."""
    from msb.render import Renderer
    from msb.render.backend import lean_options

    assert job.model is not None
    tier, engine = job.tier, job.cell.renderer
    settings = dict(job.settings)
    return Renderer(job.model.open(), tier, job.device, settings, name=engine, **lean_options(tier, engine))


def renderer_info(job: Job, name: str) -> RendererInfo:
    """Return the record of the renderer that calls itself `name`."""
    from msb.asset.settings import effective_settings

    assert job.model is not None
    title, _, version = name.rpartition(" ")
    settings = effective_settings(job.model.open().manifest, job.settings)
    return RendererInfo(
        name=title,
        version=version,
        kind="engine" if job.cell.renderer else "msb_reference" if job.tier == "reference" else "msb",
        settings=settings,
    )


def _compare(
    job: Job, camera: Camera, name: str, pixels: Pixels, truth: Path, network: metrics.LpipsVgg | None
) -> ImageQuality:
    wanted = metrics.read_image(truth)
    psnr = metrics.psnr(pixels, wanted)
    return ImageQuality(
        name=str(camera.name),
        width=camera.width,
        height=camera.height,
        psnr=None if math.isinf(psnr) else psnr,
        psnr_infinite=math.isinf(psnr),
        ssim=metrics.ssim(pixels, wanted),
        lpips=None if network is None else network(pixels, wanted),
        file=f"images/{name}.png",
        gt=_relative(truth, job.folder),
    )


def _summary(rows: list[ImageQuality], network: metrics.LpipsVgg | None) -> Quality:
    psnr, infinite = metrics.mean_psnr(math.inf if row.psnr is None else row.psnr for row in rows)
    return Quality(
        psnr=psnr,
        ssim=mean_of(row.ssim for row in rows),
        lpips=mean_of(row.lpips for row in rows),
        lpips_reason=NO_WEIGHTS if network is None else None,
        psnr_inf_count=infinite,
        images=tuple(rows),
        metrics=identities(network),
    )


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path, folder).replace(os.sep, "/")
