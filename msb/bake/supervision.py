"""The supervision of a bake: native renderings, photographs, or the better of both kinds."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path

from msb.asset import Asset
from msb.asset.origin import without_origin
from msb.asset.tiers import why_not
from msb.bake.context import ProgressHook
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.options import BakeOptions, Supervision
from msb.bake.pipeline import BakePipeline, Choice
from msb.bake.quality import measure_psnr
from msb.bake.views import BakeViews, choose_bake_views
from msb.base.origin import NO_ORIGIN
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from msb.scenes.datasets import Scene, scene_of

# Photographs supervise if the PSNR gain on photographs of the validation views is at least this number of dB.
# A smaller PSNR gain is not worth the loss of the native rendering.
_MIN_GAIN = 0.5


@dataclass(frozen=True)
class BakeInputs:
    """The inputs of `msb.bake` other than its options."""

    model: Asset
    scene: Scene | str | os.PathLike[str] | None
    cameras: Iterable[Camera] | None
    background: Sequence[float] | str | None
    device: str | None
    cache: Path | None
    progress: ProgressHook


@dataclass(frozen=True, eq=False)
class Attempt:
    """The result of a bake with one supervision: views, image source, pipeline, mesh and choice."""

    views: BakeViews
    source: ImageSource
    pipeline: BakePipeline
    mesh: Mesh
    choice: Choice


def make_best_attempt(
    inputs: BakeInputs, options: BakeOptions, stack: ExitStack, stopped: Callable[[], bool]
) -> tuple[Attempt, dict[str, float], list[str]]:
    """Return the attempt with the better supervision. Also return the validation PSNRs in dB, and notes.

    The PSNR values refer to photographs. The mapping is empty unless two supervisions were tried. The exit
    stack `stack` closes the image sources and the pipelines.
    """
    if inputs.scene is not None and not isinstance(inputs.scene, Scene):
        inputs = replace(inputs, scene=scene_of(inputs.model.manifest, inputs.scene))
    native = _make_attempt(inputs, options, options.supervision or "native", stack, stopped)
    is_free = options.supervision is None and options.geometry == "auto"
    if not is_free or not _can_compare(inputs, native.views) or stopped():
        return native, {}, []
    attempts = {
        "native": native,
        "photographs": _make_attempt(inputs, options, "photographs", stack, stopped),
    }
    # Compare the renderings of both attempts with the photographs of the validation views.
    cameras = [camera for camera in native.views.validation if _has_photograph(camera)]
    psnr = {}
    with native.source.photographs(cameras) as targets:
        for name, attempt in attempts.items():
            asset = asset_from_mesh(attempt.mesh, origin=NO_ORIGIN)
            psnr[name] = measure_psnr(asset, [targets], SAMPLES_PER_SIDE, inputs.device)[0]
    values = ", ".join(f"{name} {value:.1f} dB" for name, value in psnr.items())
    if psnr["photographs"] < psnr["native"] + _MIN_GAIN:
        note = "native renderings supervise, because photographs gain too little on the validation views"
        return native, psnr, [f"{note} ({values})"]
    note = (
        "photographs supervise, so the result does not reproduce the native rendering; pass "
        "--supervision native to use native renderings"
    )
    return attempts["photographs"], psnr, [f"{note} (validation PSNR to photographs: {values})"]


def _make_attempt(
    inputs: BakeInputs,
    options: BakeOptions,
    supervision: Supervision,
    stack: ExitStack,
    stopped: Callable[[], bool],
) -> Attempt:
    """Bake with a supervision, in coordinates relative to the origin of the model."""
    inputs.progress("views", 0, 1)
    views = choose_bake_views(
        inputs.model,
        inputs.scene,
        inputs.cameras,
        up=options.up,
        background=inputs.background,
        photographs=supervision == "photographs",
        device=inputs.device,
        kind=options.views,
    )
    inputs.progress("views", 1, 1)
    model, views = without_origin(inputs.model), views.relative_to(inputs.model.manifest.origin)
    source = stack.enter_context(ImageSource(model, views, supervision, inputs.device, inputs.cache))
    pipeline = stack.enter_context(
        closing(BakePipeline(model, views, source, options, inputs.device, inputs.progress))
    )
    mesh, choice = pipeline.make_mesh(stopped)
    return Attempt(views, source, pipeline, mesh, choice)


def _can_compare(inputs: BakeInputs, views: BakeViews) -> bool:
    """Return whether a trained model has photographs for its training and validation views.

    A mesh file should keep its colours, so photographs do not supervise a mesh file by default.
    """
    if why_not(inputs.model.manifest, "dedicated") is not None:
        return False
    if inputs.scene is None or not any(map(_has_photograph, views.validation)):
        return False
    return any(map(_has_photograph, views.training))


def _has_photograph(camera: Camera) -> bool:
    return camera.image_path is not None and Path(camera.image_path).is_file()
