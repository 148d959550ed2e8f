"""What a plain asset shows of the views held back, in dB: to the model's own look, and to photographs."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import Any

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.lessons import Lessons
from msb.bake.report import Psnr, mean
from msb.bake.teacher import SAMPLES, Teacher
from msb.bake.views import BakeViews
from msb.metrics import psnr
from msb.render.standard.renderer import StandardRenderer


def measured(
    asset: Asset, made: Asset, views: BakeViews, master: Teacher, device: str | None
) -> tuple[Psnr | None, Psnr | None]:
    """Return the numbers of what was `made` of an asset: against its own look, and against photographs.

    There are none where no view is held back, and none of the second without a scene.
    """
    held_back = views.held_back
    if not held_back:
        return None, None
    with ExitStack() as stack:
        truths = [stack.enter_context(master.looks(held_back))]
        if views.scene is not None:
            truths.append(stack.enter_context(master.photographs(held_back)))
        for number in range(len(held_back)):
            truths[0].stored(number)
        master.rest()
        before: list[Any] = [None, None]
        if why_not(asset.manifest, "standard") is None:
            before = mean_psnr(asset, truths, 1, device)
        after, after_16 = (mean_psnr(made, truths, samples, device) for samples in (1, SAMPLES))
        own = Psnr(None, before[0], after[0], after_16[0])
        if len(truths) == 1:
            return own, None
        looks, photographs = truths
        dedicated = [psnr(looks.image(k), photographs.image(k)) for k in range(len(held_back))]
        return own, Psnr(mean(dedicated), before[1], after[1], after_16[1])


def mean_psnr(asset: Asset, truths: Sequence[Lessons], samples: int, device: str | None) -> list[float]:
    """Return the mean dB of the standard tier to each of the truths, which are of the same cameras.

    It is drawn with so many `samples` along each side of a pixel.
    """
    found: list[list[float]] = [[] for _ in truths]
    with closing(StandardRenderer(asset, device=device, supersample=samples)) as renderer:
        for number, camera in enumerate(truths[0].cameras):
            image = renderer.render_image(camera.in_units(), truths[0].background)
            for values, truth in zip(found, truths, strict=True):
                values.append(psnr(image, truth.image(number)))
    return [mean(values) for values in found]
