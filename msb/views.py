"""The views that judge a model where none are given, and how images of them differ.

They are those of its training, else round it or inside it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.errors import DeviceError, UsageError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.metrics.images import psnr_of_mse
from msb.registry import Tier
from msb.render import Renderer
from msb.render.backend import lean_options
from msb.render.images import to_bytes
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from msb.scenes.around import around, bulk_of, inside, surrounded
from msb.scenes.sets import given_cameras

# Cameras of a training that are taken, evenly spread.
MOST = 12
# The size of the pictures that tell a room from a thing.
_LOOK = (320, 240)
# Faces that are looked for in them.
_SAMPLES = 4000
# Share of what is seen from outside that is seen from behind, from which on the winding says that outside is
# the wrong side. Faces that are wound at random have a half.
_BEHIND = 2 / 3
# How much deeper than what a picture shows a face may be and still be seen.
_SLACK = 1.01


@dataclass(frozen=True)
class Views:
    """Cameras, where they are from, the same in words, and the file or folder of a training's."""

    cameras: list[Camera]
    origin: Literal["given", "training", "turntable", "inside"]
    said: str
    place: Path | None = None

    @property
    def nothing(self) -> str:
        """What to say where none of the cameras sees a pixel of the mesh."""
        if self.origin == "given":
            return f"no camera sees the mesh ({self.said}): they look elsewhere, or are of other coordinates"
        return f"no camera sees the mesh ({self.said}); --cameras gives others"

    def seeing(self, asset: Asset, device: str | None = None) -> Views:
        """Return those that see a pixel of the asset, on the standard tier or as its method draws it."""
        useful = _that_see(asset, self.cameras, device, len(self.cameras))
        if useful is None or len(useful) == len(self.cameras):
            return self
        blind = len(self.cameras) - len(useful)
        said = f"{self.said}; {blind} see none of it and do not count" if useful else self.said
        return replace(self, cameras=[self.cameras[k] for k in sorted(useful)], said=said)


def _that_see(asset: Asset, cameras: Sequence[Camera], device: str | None, enough: int) -> set[int] | None:
    """Return which cameras see a pixel of the asset, of the first so many that do.

    None where nothing can draw it: whoever draws says why.
    """
    every: tuple[Tier, ...] = ("standard", "dedicated")
    tiers = [tier for tier in every if why_not(asset.manifest, tier) is None]
    if not tiers:
        return None
    seeing: set[int] = set()
    try:
        for tier in tiers:
            if len(seeing) == min(enough, len(cameras)):
                break
            with Renderer(asset, tier, device, **lean_options(tier, None)) as renderer:
                for number, camera in enumerate(cameras):
                    if len(seeing) < enough and number not in seeing:
                        seeing |= {number} if (renderer.render(camera).alpha > 0).any() else set()
    except DeviceError:
        return None
    return seeing


def choose_views(
    asset: Asset,
    given: Views | Iterable[Camera] | None = None,
    *,
    count: int = 8,
    size: tuple[int, int] = (640, 480),
    device: str | None = None,
) -> Views:
    """Return the views that judge an asset: those of its training are looked for where it was opened from.

    Parameters
    ----------
    given : iterable of Camera, optional
        Somebody's wish, which is taken.
    count : int
        Views round the asset, or inside it.
    size : (int, int)
        Their width and height; those of a training have no longer side.
    """
    if isinstance(given, Views):
        return given
    if given is not None:
        return given_views(given)
    outside = around(asset, count, *size)
    try:
        found = training_views(asset, device, most=MOST, longest=max(size))
        return found or made_views(asset, outside, device)
    except DeviceError:  # whoever draws says so
        return _round_it(outside)


def given_views(cameras: Iterable[Camera]) -> Views:
    """Return the cameras that a caller gives."""
    chosen = given_cameras(cameras)
    if not chosen:
        raise UsageError("USAGE", "cameras is empty; it must hold at least one, or be None")
    return Views(chosen, "given", f"{len(chosen)} camera{'' if len(chosen) == 1 else 's'} given")


def training_views(
    asset: Asset, device: str | None = None, *, most: int | None = None, longest: int | None = None
) -> Views | None:
    """Return the cameras of an asset's training, looked for where it was opened from, if one sees it.

    They are all, or `most` of them, evenly spread; in their own size, or with sides of at most `longest`.
    """
    from msb.adapters.training_cameras import training_cameras

    if asset.opened_from is None:
        return None
    for cameras, found in training_cameras(asset.opened_from, asset.manifest.method):
        few = spread(cameras, most or len(cameras))
        if longest is not None:
            few = [one.scaled(min(1.0, longest / max(one.width, one.height))) for one in few]
        of = f"{len(few)} of {len(cameras)}" if len(few) < len(cameras) else f"{len(few)}"
        if _that_see(asset, few, device, 1) != set():
            return Views(few, "training", f"{of} cameras of the training ({found.name})", found)
    return None


def made_views(
    asset: Asset, outside: list[Camera], device: str | None = None, up: str | None = None
) -> Views:
    """Return the views from `outside` of an asset, or as many from inside, where it is an interior.

    Their upright axis is `up`, that of the asset if not given.
    """
    bulk = bulk_of(asset)
    within = inside(asset, bulk, outside, up)
    if not within:
        return _round_it(outside)
    if surrounded(bulk):
        why = "large faces surround most of it"
    elif _is_interior(asset, outside, within, device):
        why = "most of its faces are hidden from outside, or seen from behind"
    else:
        return _round_it(outside)
    return Views(within, "inside", f"{len(within)} views from inside: {why}; --cameras gives others")


def _round_it(outside: list[Camera]) -> Views:
    return Views(outside, "turntable", f"{len(outside)} views round it")


def spread(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return `count` of the cameras, or all of them, evenly spread from the first one on."""
    if len(cameras) <= count:
        return list(cameras)
    return [cameras[k * len(cameras) // count] for k in range(count)]


def _is_interior(asset: Asset, outside: list[Camera], within: list[Camera], device: str | None) -> bool:
    """Return whether most faces are hidden, or seen from behind, from outside, and more are seen within.

    Whether a face is seen says its middle: its size, in pixels or in the world, is of no account.
    """
    if why_not(asset.manifest, "standard") is not None:
        return False
    with Renderer(asset, "standard", device) as renderer:
        front, back, behind = _seen(asset, renderer, outside)
        sided = behind >= _BEHIND or behind <= 1 - _BEHIND
        shown = (front if sided else front | back).mean()
        if shown >= 0.5:
            return False
        front, back, _ = _seen(asset, renderer, within)
        return bool((front if sided else front | back).mean() > shown)


def _seen(
    asset: Asset, renderer: Renderer, cameras: list[Camera]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], float]:
    """Return which of some faces are seen from the front, which from behind, and how often from behind."""
    faces = asset.buffers["indices"]
    corners = asset.buffers["positions"][faces[:: max(1, len(faces) // _SAMPLES)]].astype(np.float64)
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front, back = np.zeros((2, len(middle)), bool)
    sides = [0, 0]
    for camera in (one.resized(*_LOOK) for one in cameras):
        depth = renderer.render(camera).depth
        pixels, z = camera.project(middle)
        column, row = np.floor(np.nan_to_num(pixels, nan=-1.0)).T
        here = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        there = np.where(
            here, depth[np.where(here, row, 0).astype(int), np.where(here, column, 0).astype(int)], 0
        )
        seen = (there > 0) & (z <= _SLACK * there)
        facing = (normal * (camera.center - middle)).sum(axis=1) > 0
        front |= seen & facing
        back |= seen & ~facing
        sides = [sides[0] + int((seen & facing).sum()), sides[1] + int((seen & ~facing).sum())]
    return front, back, sides[1] / max(1, sum(sides))


def images_of(
    mesh: Mesh,
    cameras: Iterable[Camera],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    device: str | None = None,
    supersample: int = 1,
) -> list[NDArray[np.float32]]:
    """Return images (H, W, 3) of any mesh on the standard tier."""
    renderer = StandardRenderer(asset_from_mesh(mesh), device=device, supersample=supersample)
    with contextlib.closing(renderer):
        return [renderer.render_image(camera.in_units(), background) for camera in cameras]


def squared_errors(ones: Sequence[Any], others: Sequence[Any]) -> NDArray[np.float64]:
    """Return for each view (n, 2) the sum of squared differences and the number of values.

    Views are images or frames; differences are in levels of 8 bits.
    """
    sums = []
    for one, other in zip(ones, others, strict=True):
        levels = [to_bytes(np.asarray(getattr(drawn, "image", drawn))) for drawn in (one, other)]
        change = np.subtract(*levels, dtype=np.int32)
        # Not a product of matrices, whose threads would then spin beside the kernels.
        sums.append((np.square(change, out=change).sum(dtype=np.int64), change.size))
    return np.array(sums, np.float64)


def difference(ones: Sequence[Any], others: Sequence[Any]) -> float:
    """Return the PSNR in dB of all views at once: a mean is infinite as soon as two images are equal."""
    return pooled_psnr(squared_errors(ones, others))


def pooled_psnr(errors: NDArray[np.float64]) -> float:
    """Return the PSNR in dB of all views of which `squared_errors` returned `errors`."""
    squares, count = errors.sum(axis=0)
    return psnr_of_mse(squares / (255**2 * count))
