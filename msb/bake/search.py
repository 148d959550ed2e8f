"""Which faces of an opaque soup to show: many are tried at once, and each change is kept only if it pays.

A round hides a part of the faces and shows some that are hidden, draws some views before and after, and
books what each pixel's squared error gains or loses to the face that it shows or showed
(`msb.bake.raster`). A change is taken if its gain stands out of its own spread over the views, so that
faces of few pixels do not follow noise."""

import numpy as np

from msb.bake.arrays import Floats, Ints, Mask
from msb.bake.raster import Raster
from msb.bake.soup import Soup

SHARE = 0.08  # share of the faces tried in a round; so few that neighbours rarely change together
BATCH = 8  # views that judge a round
SURE = 0.5  # standard errors by which a gain must exceed 0
_LEAST = 1e-4  # squared error over all views of a round that a gain must exceed


def try_faces(
    soup: Soup,
    raster: Raster,
    random: np.random.Generator,
    *,
    hide: bool = True,
    show: bool = True,
    most: int | None = None,
) -> None:
    """Hide some of the faces that are shown, and show some that are not, where that pays.

    Both at once takes half the drawings, and mistakes the one for the other where they meet. No more are
    shown than make `most` in all.
    """
    shown, hidden = (_some(soup, random, pool) for pool in (soup.keep & hide, ~soup.keep & show))
    room = None if most is None else max(0, most - soup.count)
    chosen = np.concatenate([shown, hidden[:room]])
    if not len(chosen):
        return
    rise = _rise(soup, raster, random, chosen)
    views, total = len(rise), rise.sum(axis=0)
    squares = np.maximum(np.square(rise).sum(axis=0) - total**2 / views, 0)
    spread = np.sqrt(views * squares / max(views - 1, 1))
    pays = total < -SURE * spread - _LEAST
    soup.keep[chosen[pays]] ^= True


def hide_least(soup: Soup, raster: Raster, random: np.random.Generator, most: int) -> None:
    """Hide faces until `most` are shown: of some at a time the quarter by which the error rises least."""
    while (over := soup.count - most) > 0:
        chosen = _some(soup, random, soup.keep)
        total = _rise(soup, raster, random, chosen).sum(axis=0)
        worst = np.argsort(total, kind="stable")[: min(over, -(-len(chosen) // 4))]
        soup.keep[chosen[worst]] = False


def _some(soup: Soup, random: np.random.Generator, pool: Mask) -> Ints:
    """Return a part of all faces, at random, of those in `pool` (F,)."""
    numbers = np.flatnonzero(pool)
    count = min(len(numbers), max(1, int(SHARE * len(soup.keep))))
    return random.choice(numbers, count, replace=False)


def _rise(soup: Soup, raster: Raster, random: np.random.Generator, chosen: Ints) -> Floats:
    """Return by how much the error of each of some views rises if each face is hidden, or shown where it is
    not."""
    owner = np.full(len(soup.keep), -1, np.int32)
    owner[chosen] = np.arange(len(chosen), dtype=np.int32)
    soup.put_on(raster)
    raster.remember(some_views(raster, random))
    keep = soup.keep.copy()
    keep[chosen] ^= True
    raster.change(soup.corners, soup.colors, keep)
    return raster.judge(owner, len(chosen))


def some_views(raster: Raster, random: np.random.Generator) -> list[int]:
    """Return a batch of views, in their order."""
    count = len(raster.lessons)
    return sorted(random.choice(count, min(BATCH, count), replace=False).tolist())
