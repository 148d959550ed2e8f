"""The part "quality" of a benchmark cell: write images, and compare them with the photographs."""

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
from msb.bench.photographs import read_planned_scene
from msb.bench.records import ImageQuality, Quality, RendererInfo, average_images
from msb.bench.renders import check_size, find_renders
from msb.errors import MetricError, UsageError
from msb.metrics.identity import defined
from msb.metrics.images import check_image, is_plain
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
    """Return the keys of a record about images: quality, setup, renderer, device and renders."""
    scene = read_planned_scene(job.scene, job.views)
    official = job.renders is not None
    source: _OfficialImages | _RenderedImages
    source = _OfficialImages(job, scene) if official else _RenderedImages(job, scene)
    names = image_names(scene.test)
    measures = load_measures(job.vgg_weights)
    if job.parts["quality"].get("metrics") not in (None, hash_metrics(job.vgg_weights)):
        installed = ", ".join(identity.name for identity in measures.identities)
        text = f"this worker has other metrics than the run ({installed}); install its packages here"
        raise UsageError("PACKAGE_LEFT_OUT", text)
    # Compare images while other threads compress and write the images.
    compared: list[dict[str, Any]] = []
    with new_folder(job.folder / "images") as folder, Writers() as writers:
        for name, camera, image in zip(names, scene.test, source.images(), strict=True):
            writers.submit(write_image, folder / f"{name}.png", image, "png")
            truth = job.photographs / f"{name}.png"
            compared.append(_compare(job, camera, name, to_bytes(image), truth, measures))
        if not source.is_visible:
            text = (
                "the model is not visible in any test view; check that it is in the coordinates of the scene"
            )
            raise MetricError("METRIC_NOTHING_SHOWN", text)
    rows = [ImageQuality(**row, sha256=file_sha256(job.folder / row["file"])) for row in compared]
    return {
        "quality": _summarize(rows, measures, job.vgg_weights),
        "setup": job.views.setup,
        **source.about(),
    }


@lru_cache(maxsize=1)
def load_measures(weights: Path | None) -> metrics.Measures:
    """Return the image metrics. The weights of the metrics are loaded once per process."""
    return metrics.Measures(weights)


def hash_metrics(weights: Path | None) -> str:
    """Return a hash of the definitions of all metrics.

    While this hash does not change, recorded values remain valid.
    """
    return digest([defined(identity.to_dict()) for identity in load_measures(weights).identities])


@dataclass
class _OfficialImages:
    """Renderings by the method's authors, read from files."""

    job: Job
    scene: Scene
    # Whether at least one image is not uniform.
    is_visible: bool = False

    def __post_init__(self) -> None:
        assert self.job.renders is not None
        self.renders = find_renders(self.job.renders, self.scene.test)

    def images(self) -> Iterator[NDArray[np.float32]]:
        for path, camera in zip(self.renders.files, self.scene.test, strict=True):
            image = metrics.read_image(path, background=self.scene.background)
            check_size(path, (image.shape[1], image.shape[0]), camera)
            try:  # check the floats, because bytes cannot store NaN
                check_image(image, "the rendering")
            except MetricError as error:
                raise error.at(path) from None
            scale = np.float32(255 if image.dtype == np.uint8 else 1)
            self.is_visible |= not is_plain(image)
            yield np.asarray(image, np.float32) / scale

    def about(self) -> dict[str, Any]:
        info = RendererInfo(
            name=self.job.cell.method,
            version="",
            kind="upstream",
            settings={"matched_by": self.renders.matched_by},
        )
        return {"renders": self.renders.folder, "renderer": info, "device": None}


@dataclass
class _RenderedImages:
    """Images that are rendered during the run, by one of our renderers or by an engine."""

    job: Job
    scene: Scene
    name: str = ""
    engine: Mapping[str, str] | None = None
    # Whether at least one image shows the model.
    is_visible: bool = False

    def images(self) -> Iterator[NDArray[np.float32]]:
        with open_renderer(self.job) as renderer:
            self.name, self.engine = renderer.name, renderer.device_info
            for camera in self.scene.test:
                frame = renderer.render(camera, self.scene.background)
                empty = (frame.alpha == 0).all() and (
                    frame.image == np.asarray(self.scene.background, np.float32)
                ).all()
                self.is_visible |= not empty
                yield frame.image

    def about(self) -> dict[str, Any]:
        uses_opencl = self.job.tier != "reference"
        return {
            "renderer": describe_renderer(self.job, self.name),
            "device": machine(self.job.device, opencl=uses_opencl, engine=self.engine),
        }


def open_renderer(job: Job, asset: Asset | None = None) -> Renderer:
    """Return the renderer for the asset of a benchmark cell.

    If `asset` is given, the renderer draws this asset in place of the benchmark cell's asset.

    The renderer omits buffers that are only needed by other commands.
    """
    from msb.render import Renderer
    from msb.render.backend import minimal_options

    assert job.model is not None
    tier, engine = job.tier, job.cell.renderer
    settings = dict(job.settings)
    options = {**minimal_options(tier, engine), **job.options}
    return Renderer(asset or job.model.open(), tier, job.device, settings, name=engine, **options)


def describe_renderer(job: Job, name: str) -> RendererInfo:
    """Return the record of a renderer: its name, version and settings.

    `name` is "TITLE VERSION". The settings are taken from the job.
    """
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
    """Return the values of `ImageQuality`. The hash of the image file is missing, because the file is still
    being written.

    `pixels` is the image as (H, W, 3) uint8. `truth` is the file of the photograph.
    """
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


def _summarize(rows: list[ImageQuality], measures: metrics.Measures, weights: Path | None) -> Quality:
    """Return the average of each metric over all images, and the identity of each metric."""
    averages: dict[str, Any] = average_images(rows)
    return Quality(
        **averages,
        lpips_reason=NO_WEIGHTS if weights is None else None,
        missing={key: text for key, text in measures.failed.items() if averages[key] is None},
        psnr_inf_count=sum(row.psnr_infinite for row in rows),
        images=tuple(rows),
        metrics=tuple(identity.to_dict() for identity in measures.identities),
    )
