"""Face selection of an opaque soup: hide or show many faces at once, and keep useful changes.

A selection round hides some selected faces, shows some hidden faces, and renders a few views before and after
the change. The change of a pixel's error is assigned to two faces: the face that the pixel showed before the
change, and the face that the pixel shows afterwards (`SoupRenderer.measure_changes`). A change of the
selection is kept if its gain over the views is statistically significant. Without this test, noise would
decide about faces with few pixels.
"""

import numpy as np

from msb.bake.arrays import Floats, Ints, Mask
from msb.bake.soup import Soup
from msb.bake.soup_renderer import SoupRenderer

# Share of the faces that a selection round tries. The share is small, so that neighbouring faces rarely
# change together. If two neighbours changed together, the error of one face could be assigned to its
# neighbour.
TRIED_SHARE = 0.08
# A selection round and a descent step render this number of views. The time grows with the number of views,
# and the noise falls with its square root.
BATCH_VIEWS = 8
# A gain must exceed its standard error multiplied by this number. Without a test of the standard error, faces
# with few pixels overfit the training views.
MIN_STANDARD_ERRORS = 0.5
# A gain must also exceed this value, in squared error summed over all views of a round. This value is far
# below the error of one wrong pixel.
_MIN_GAIN = 1e-4
# `hide_cheapest_faces` hides a quarter of the tried faces per round. The error of each tried face is measured
# while the other tried faces are visible. Hiding overlapping faces together would leave a hole.
_TRIED_PER_HIDDEN = 4


def toggle_faces(
    soup: Soup,
    renderer: SoupRenderer,
    random: np.random.Generator,
    *,
    hide: bool = True,
    show: bool = True,
    most: int | None = None,
) -> None:
    """Hide some selected faces and show some hidden faces if the change reduces the error.

    Hiding and showing in one round halves the renderings, but mixes the gains of overlapping faces. At most
    `most` faces are selected afterwards.
    """
    selected, hidden = (
        _pick_faces(soup, random, pool) for pool in (soup.selected & hide, ~soup.selected & show)
    )
    room = None if most is None else max(0, most - soup.selected_count)
    chosen = np.concatenate([selected, hidden[:room]])
    if not len(chosen):
        return
    # Compute the error increase (views, n), its sum over the views, and the standard error of the sum.
    rise = _measure_toggle(soup, renderer, random, chosen)
    views, total = len(rise), rise.sum(axis=0)
    squares = np.maximum(np.square(rise).sum(axis=0) - total**2 / views, 0)
    spread = np.sqrt(views * squares / max(views - 1, 1))
    is_gain = total < -MIN_STANDARD_ERRORS * spread - _MIN_GAIN
    soup.selected[chosen[is_gain]] ^= True


def hide_cheapest_faces(soup: Soup, renderer: SoupRenderer, random: np.random.Generator, most: int) -> None:
    """Hide the least useful faces until only `most` faces are selected.

    Each round hides a quarter of the tried faces, namely the faces whose removal increases the error least.
    """
    while (over := soup.selected_count - most) > 0:
        chosen = _pick_faces(soup, random, soup.selected)
        total = _measure_toggle(soup, renderer, random, chosen).sum(axis=0)
        cheapest = np.argsort(total, kind="stable")[: min(over, -(-len(chosen) // _TRIED_PER_HIDDEN))]
        soup.selected[chosen[cheapest]] = False


def _pick_faces(soup: Soup, random: np.random.Generator, pool: Mask) -> Ints:
    """Return random faces of `pool` (F,), at most the share `TRIED_SHARE` of all faces."""
    numbers = np.flatnonzero(pool)
    count = min(len(numbers), max(1, int(TRIED_SHARE * len(soup.selected))))
    return random.choice(numbers, count, replace=False)


def _measure_toggle(soup: Soup, renderer: SoupRenderer, random: np.random.Generator, chosen: Ints) -> Floats:
    """Hide or show each chosen face. Return the error increase (views, n) that each face causes."""
    owner = np.full(len(soup.selected), -1, np.int32)
    owner[chosen] = np.arange(len(chosen), dtype=np.int32)
    soup.upload(renderer)
    renderer.remember(sample_views(renderer, random))
    selected = soup.selected.copy()
    selected[chosen] ^= True
    renderer.update(soup.corners, soup.colors, selected)
    return renderer.measure_changes(owner, len(chosen))


def sample_views(renderer: SoupRenderer, random: np.random.Generator) -> list[int]:
    """Return the sorted numbers of `BATCH_VIEWS` random views."""
    count = len(renderer.images)
    return sorted(random.choice(count, min(BATCH_VIEWS, count), replace=False).tolist())
