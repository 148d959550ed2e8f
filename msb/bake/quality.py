"""The quality of a baked asset: PSNR on the test views, to native renderings and to photographs."""

import math
from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.images import ViewImages
from msb.bake.report import Psnr, average_psnr
from msb.bake.views import BakeViews
from msb.metrics import psnr
from msb.render.standard.renderer import StandardRenderer


def measure_quality(
    model: Asset, baked: Asset, views: BakeViews, source: ImageSource, device: str | None
) -> tuple[Psnr | None, Psnr | None]:
    """Return the PSNR of a baked asset on the test views, compared with native renderings and photographs.

    The PSNR is None without test views. The PSNR is also None if the model covers too few pixels. The PSNR to
    photographs is None without a scene.
    """
    test = views.test
    if not test or views.why_not_judged is not None:
        return None, None
    with ExitStack() as stack:
        targets = [stack.enter_context(source.native_images(test))]
        if views.scene is not None:
            targets.append(stack.enter_context(source.photographs(test)))
        # Draw all native renderings first, then free the memory of the native renderer.
        for number in range(len(test)):
            targets[0].stored_image(number)
        covered = [source.covers(camera) for camera in test]
        source.release()
        before: list[Any] = [None, None]
        if why_not(model.manifest, "standard") is None:
            before = measure_psnr(model, targets, 1, device)
        after, after_16 = (measure_psnr(baked, targets, samples, device) for samples in (1, SAMPLES_PER_SIDE))
        model_only = _measure_model_only(baked, targets[0], covered, device)
        to_native = Psnr(None, before[0], after[0], after_16[0], model_only)
        if len(targets) == 1:
            return to_native, None
        renderings, photographs = targets
        native = [psnr(renderings.image(k), photographs.image(k)) for k in range(len(test))]
        return to_native, Psnr(average_psnr(native), before[1], after[1], after_16[1])


def _measure_model_only(
    baked: Asset, targets: ViewImages, covered: Sequence[NDArray[np.bool_]], device: str | None
) -> float:
    """Return the average PSNR in dB over the pixels that the model or the baked mesh covers.

    `covered` contains the coverage masks (H, W) of the model. Both images show the background at pixels that
    neither mesh covers.
    """
    values = []
    with closing(StandardRenderer(baked, device=device, supersample=SAMPLES_PER_SIDE)) as renderer:
        for number, camera in enumerate(targets.cameras):
            frame = renderer.render(camera.in_units(), targets.backgrounds[number])
            share = float((covered[number] | (frame.alpha > 0)).mean())
            values.append(psnr(frame.image, targets.image(number)) + 10 * math.log10(max(share, 1e-9)))
    return average_psnr(values)


def measure_psnr(
    asset: Asset, targets: Sequence[ViewImages], samples: int, device: str | None
) -> list[float]:
    """Return the average PSNR in dB between standard-tier images and each set of target images.

    All sets of target images have the same cameras. The drawn images have `samples` samples along each side
    of a pixel.
    """
    values: list[list[float]] = [[] for _ in targets]
    with closing(StandardRenderer(asset, device=device, supersample=samples)) as renderer:
        for number, camera in enumerate(targets[0].cameras):
            image = renderer.render_image(camera.in_units(), targets[0].backgrounds[number])
            for row, target in zip(values, targets, strict=True):
                row.append(psnr(image, target.image(number)))
    return [average_psnr(row) for row in values]
