"""How alike two conditions' renderings are, compared with each other instead of with a photograph."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

from msb import metrics
from msb.errors import MsbError
from msb.metrics.images import PSNR_CAP

if TYPE_CHECKING:
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
    others = {image.name: image for image in second.images}
    pairs = [(image, others[image.name]) for image in first.images if image.name in others]
    count = min(_MOST, len(pairs))
    chosen = [pairs[number * len(pairs) // count] for number in range(count)]
    with ThreadPoolExecutor() as pool:
        values = list(pool.map(lambda pair: _between(first, second, *pair), chosen))
    known = [value for value in values if value is not None]
    if not known or len(known) < count:
        return None
    return Likeness(math.fsum(known) / count, count, len(pairs))


def _between(first: Loaded, second: Loaded, one: ImageQuality, other: ImageQuality) -> float | None:
    if one.sha256 == other.sha256:
        return PSNR_CAP
    files = first.file(one.file), second.file(other.file)
    if files[0] is None or files[1] is None or first.changed(one) or second.changed(other):
        return None
    try:
        return min(PSNR_CAP, metrics.psnr(metrics.read_image(files[0]), metrics.read_image(files[1])))
    except MsbError:
        return None
