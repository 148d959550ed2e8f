"""How a model was trained otherwise than the benchmark evaluates it, in words with the consequence."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from msb.base.paths import SpelledFiles
from msb.errors import Finding, MsbError, finding
from msb.scenes.datasets.describe import color_name
from msb.scenes.image_size import image_size

if TYPE_CHECKING:
    from msb.scenes.colors import Color
    from msb.scenes.datasets.scene import Scene
    from msb.scenes.datasets.sizes import Size

_FACTORS = (1, 2, 4, 8)
_WIDEST = 1600
"""Values of the option resolution that divide, and the width that -1 allows: 3DGS and what follows it."""


def trained_otherwise(training: Mapping[str, Any], own: Color | None, scene: Scene) -> Iterator[Finding]:
    """Yield a warning for each way in which the training differs from how `scene` is evaluated.

    Parameters
    ----------
    training : mapping
        The key `training` of a manifest.
    own : (float, float, float), optional
        The background that the model was trained over, where the asset states it.
    scene : Scene
    """
    if training.get("eval") is False:
        yield saw_test_views()
    if own is not None and own != scene.background:
        yield over_another(own, scene.background)
    there = scene.test[0].width, scene.test[0].height
    size = _size(training, scene)
    if size is not None and max(abs(a - b) for a, b in zip(size, there, strict=True)) > 1:
        before, now = (f"{width} x {height}" for width, height in (size, there))
        yield _otherwise(
            f"it was trained on photographs of {before} pixels and is evaluated at {now}: its numbers are "
            "not those of a model that was trained at that size"
        )


def saw_test_views() -> Finding:
    """Return the warning about a model that was trained on all views."""
    return _otherwise("it was trained on the test views (eval=False): its numbers on them are not comparable")


def over_another(own: Color, drawn: Color) -> Finding:
    """Return the warning about a model that is drawn over another colour than the one it was trained over."""
    return _otherwise(
        f"it was trained over {color_name(own)} and is drawn over {color_name(drawn)}: where the background "
        "shows, it differs from photographs for that alone"
    )


def _otherwise(text: str) -> Finding:
    return finding("CHECKPOINT_CONFIG", text, severity="warning")


def _size(training: Mapping[str, Any], scene: Scene) -> Size | None:
    """Return the size of the photographs of the training, None where it cannot be told."""
    if "width" in training and "height" in training:
        return training["width"], training["height"]
    view, folder = scene.test[0], training.get("images")
    if folder in (None, "..") or scene.layout != "colmap":  # elsewhere the folder is not asked
        return None
    stored: Size | None = None
    with contextlib.suppress(MsbError):
        stored = image_size(SpelledFiles(scene.root / folder).find(str(view.name)))
    if stored is None and (divided := re.fullmatch(r"images_([1-9]\d?)", folder)):
        stored = _divided(view.source_size or (view.width, view.height), int(divided[1]))
    resolution = training.get("resolution")
    if stored is None or resolution is None:
        return stored
    if resolution in _FACTORS:
        return _divided(stored, resolution)
    width = min(stored[0], _WIDEST) if resolution == -1 else resolution
    return _divided(stored, stored[0] / width) if width > 0 else None


def _divided(size: Size, factor: float) -> Size:
    width, height = size
    return round(width / factor), round(height / factor)
