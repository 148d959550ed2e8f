"""The part "quality" of a cell: get its images, write them, and compare them with the photographs."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb import metrics
from msb.base.atomic import new_folder
from msb.base.files import file_sha256
from msb.bench.digest import digest
from msb.bench.photographs import checked_scene
from msb.bench.records import ImageQuality, Quality, RendererInfo, means_of
from msb.bench.renders import check_size, find_renders
from msb.errors import MetricError, UsageError
from msb.metrics.identity import defined
from msb.metrics.images import checked_image, is_plain
from msb.render.images import Writers, image_names, to_bytes, write_image
from msb.render.machine import machine

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.bench.job import Job
    from msb.render import Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

    Pixels = NDArray[np.uint8]

NO_WEIGHTS = "no VGG weights ([metrics] vgg_weights)"


def measure_quality(job: Job) -> dict[str, Any]:
    """Return the parts of a record about a cell's images: quality, setup, renderer, device, renders."""
    scene = checked_scene(job.scene, job.views)
    source: _Imported | _Drawn = _Imported(job, scene) if job.renders is not None else _Drawn(job, scene)
    names = image_names(scene.test)
    measures = image_measures(job.vgg_weights)
    if job.parts["quality"].get("metrics") not in (None, metrics_digest(job.vgg_weights)):
        here = ", ".join(one.name for one in measures.identities)
        text = (
            f"the metrics where this is computed are {here}, and not those of the run; install its packages"
        )
        raise UsageError("PACKAGE_LEFT_OUT", text)
    compared: list[dict[str, Any]] = []
    with new_folder(job.folder / "images") as folder, Writers() as writers:
        for name, camera, image in zip(names, scene.test, source.images(), strict=True):
            writers.submit(write_image, folder / f"{name}.png", image, "png")
            truth = job.photographs / f"{name}.png"
            compared.append(_compare(job, camera, name, to_bytes(image), truth, measures))
        if not source.shows:
            text = "no test view shows a pixel of the model, so there is nothing to compare; its coordinates "
            raise MetricError("METRIC_NOTHING_SHOWN", f"{text}may not be those of the scene")
    rows = [ImageQuality(**row, sha256=file_sha256(job.folder / row["file"])) for row in compared]
    return {
        "quality": _summary(rows, measures, job.vgg_weights),
        "setup": job.views.setup,
        **source.about(),
    }


@lru_cache(maxsize=1)
def image_measures(weights: Path | None) -> metrics.Measures:
    """Return the image metrics, their weights loaded once for a process."""
    return metrics.Measures(weights)


def metrics_digest(weights: Path | None) -> str:
    """Return a hash of the metrics' definitions, which decides whether their values still hold."""
    return digest([defined(one.to_dict()) for one in image_measures(weights).identities])


@dataclass
class _Imported:
    """Official renderings."""

    job: Job
    scene: Scene

    shows: bool = False

    def __post_init__(self) -> None:
        assert self.job.renders is not None
        self.found = find_renders(self.job.renders, self.scene.test)

    def images(self) -> Iterator[NDArray[np.float32]]:
        for path, camera in zip(self.found.files, self.scene.test, strict=True):
            image = metrics.read_image(path, background=self.scene.background)
            check_size(path, (image.shape[1], image.shape[0]), camera)
            try:  # here, because bytes are made of it before the metrics see it
                checked_image(image, "the rendering")
            except MetricError as error:
                raise error.at(path) from None
            scale = np.float32(255 if image.dtype == np.uint8 else 1)
            self.shows |= not is_plain(image)
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
    shows: bool = False

    def images(self) -> Iterator[NDArray[np.float32]]:
        with open_renderer(self.job) as renderer:
            self.name, self.engine = renderer.name, renderer.device_info
            for camera in self.scene.test:
                frame = renderer.render(camera, self.scene.background)
                empty = (frame.alpha == 0).all() and (
                    frame.image == np.asarray(self.scene.background, np.float32)
                ).all()
                self.shows |= not empty
                yield frame.image

    def about(self) -> dict[str, Any]:
        host = self.job.tier == "reference"
        return {
            "renderer": renderer_info(self.job, self.name),
            "device": machine(self.job.device, opencl=not host, engine=self.engine),
        }


def open_renderer(job: Job, asset: Asset | None = None) -> Renderer:
    """Return the cell's renderer, with options by which it computes nothing but the image.

    It draws `asset`, by default the cell's model.
    """
    from msb.render import Renderer
    from msb.render.backend import lean_options

    assert job.model is not None
    tier, engine = job.tier, job.cell.renderer
    settings = dict(job.settings)
    options = {**lean_options(tier, engine), **job.options}
    return Renderer(asset or job.model.open(), tier, job.device, settings, name=engine, **options)


def renderer_info(job: Job, name: str) -> RendererInfo:
    """Return the record of the renderer that calls itself `name`."""
    from msb.asset.settings import effective_settings

    assert job.model is not None
    title, _, version = name.rpartition(" ")
    settings = {**effective_settings(job.model.open().manifest, job.settings), **job.options}
    return RendererInfo(
        name=title,
        version=version,
        kind="engine" if job.cell.renderer else "msb_reference" if job.tier == "reference" else "msb",
        settings=settings,
    )


def _compare(
    job: Job, camera: Camera, name: str, pixels: Pixels, truth: Path, measures: metrics.Measures
) -> dict[str, Any]:
    """Return the arguments of `ImageQuality` but for the hash of the file, which is still being written."""
    values = measures(pixels, metrics.read_image(truth))
    equal = values["psnr"] == math.inf
    return {
        "name": str(camera.name),
        "width": camera.width,
        "height": camera.height,
        "psnr_infinite": equal,
        **values,
        "psnr": None if equal else values["psnr"],
        "file": f"images/{name}.png",
        "gt": os.path.relpath(truth, job.folder).replace(os.sep, "/"),
    }


def _summary(rows: list[ImageQuality], measures: metrics.Measures, weights: Path | None) -> Quality:
    means: dict[str, Any] = means_of(rows)
    return Quality(
        **means,
        lpips_reason=NO_WEIGHTS if weights is None else None,
        missing={key: text for key, text in measures.failed.items() if means[key] is None},
        psnr_inf_count=sum(row.psnr_infinite for row in rows),
        images=tuple(rows),
        metrics=tuple(one.to_dict() for one in measures.identities),
    )
