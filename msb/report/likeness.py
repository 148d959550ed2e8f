"""How alike two conditions' renderings are, compared with each other instead of with a photograph."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

from msb import metrics
from msb.errors import MsbError
from msb.files import file_sha256
from msb.metrics.images import PSNR_CAP

if TYPE_CHECKING:
    from pathlib import Path

    from msb.bench.records import ImageQuality
    from msb.report.results import Loaded

_MOST = 8
"""Views that are compared, evenly spread: a report of a whole benchmark is not to take minutes."""


class Likeness(NamedTuple):
    """The mean PSNR between two sets of renderings in dB, and of how many views of how many it is."""

    psnr: float
    views: int
    of: int


def likeness(first: Loaded, second: Loaded) -> Likeness | None:
    """Return how alike the renderings of two records are; None unless their files are there and unchanged.

    The PSNR of a pair is capped at 100 dB, which equal images have.
    """
    others = {image.name: image for image in _images(second)}
    pairs = [(image, others[image.name]) for image in _images(first) if image.name in others]
    count = min(_MOST, len(pairs))
    chosen = [pairs[number * len(pairs) // count] for number in range(count)]
    with ThreadPoolExecutor() as pool:
        values = list(pool.map(lambda pair: _between(first, second, *pair), chosen))
    known = [value for value in values if value is not None]
    if not known or len(known) < count:
        return None
    return Likeness(math.fsum(known) / count, count, len(pairs))


def _images(loaded: Loaded) -> tuple[ImageQuality, ...]:
    return () if loaded.result.quality is None else loaded.result.quality.images


def _between(first: Loaded, second: Loaded, one: ImageQuality, other: ImageQuality) -> float | None:
    if one.sha256 is not None and one.sha256 == other.sha256:
        return PSNR_CAP
    files = _unchanged(first, one), _unchanged(second, other)
    if files[0] is None or files[1] is None:
        return None
    try:
        return min(PSNR_CAP, metrics.psnr(*map(metrics.read_image, files)))  # type: ignore[arg-type]
    except MsbError:
        return None


def _unchanged(loaded: Loaded, image: ImageQuality) -> Path | None:
    """Return the file of a rendering, None where it is not there or not the one that was compared."""
    path = loaded.file(image.file)
    try:
        return path if path is not None and image.sha256 in (None, file_sha256(path)) else None
    except MsbError:
        return None
