"""What pictures lose by a file, and how coarse one for the web may therefore be."""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.base.soup import is_unindexed
from msb.errors import DeviceError
from msb.meshes import Mesh
from msb.meshes.formats import FORMATS, Style, Web
from msb.scenes import Camera

# dB to the asset that a file for the web keeps, in pictures of four samples a pixel each way.
LEAST = 50.0
_SAMPLES = 4
# Quarters of a bit of positions, of which the fewest are taken that keep so much.
_COARSEST, _FINEST = 40, 88
# Levels that a byte of linear light may be off by before it gets a second one.
_LEVELS = (None, 4.0, 2.0, 1.0, 0.5)


@dataclass(frozen=True)
class Pictures:
    """How much meshes differ from one of an asset in the views that judge it."""

    mesh: Mesh
    cameras: list[Camera]
    said: str
    # Samples a pixel each way -> the pictures of `mesh`.
    _own: dict[int, list[NDArray[np.float32]]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, mesh: Mesh, asset: Asset | None) -> Pictures:
        """Return those of `mesh`; without an asset it is a file's."""
        from msb.meshes.assets import asset_from_mesh
        from msb.views import choose_views

        chosen = choose_views(asset or asset_from_mesh(mesh), count=4, size=(480, 360))
        return cls(mesh, chosen.cameras[:4], chosen.said)

    def loss(self, other: Mesh, samples: int = _SAMPLES) -> float:
        """Return the PSNR in dB of `other`, with so many samples a pixel each way."""
        from msb.views import difference

        if samples not in self._own:  # a search asks often
            self._own[samples] = self._drawn(self.mesh, samples)
        return difference(self._own[samples], self._drawn(other, samples))

    def _drawn(self, mesh: Mesh, samples: int) -> list[NDArray[np.float32]]:
        from msb.views import images_of

        return images_of(mesh, self.cameras, supersample=samples)

    def lost(self, other: Mesh) -> str:
        """Return the same in words that follow a sentence; nothing where there is no device to draw on."""
        try:
            return f": {self.loss(other):.1f} dB of {self.said}"
        except DeviceError:
            return ""


def web_style(pictures: Pictures) -> tuple[Style, str]:
    """Return how a file for the web is written, as coarse as pictures allow, and how far that is.

    Where there is no device to draw on, hardly anything is lost.
    """
    try:
        return _coarsest(pictures)
    except DeviceError:
        return _style(Web(_FINEST, _LEVELS[-1])), "not measured, as nothing can draw here"


def _coarsest(pictures: Pictures) -> tuple[Style, str]:
    """Try what each part may lose by itself, whose noise adds, and take of all that the smallest file."""
    from msb.meshes.glb_web import Grid, srgb_of, stored_light

    mesh = as_glb(pictures.mesh)
    colors = mesh.vertex_colors

    @cache
    def noise(quarters: int, *, by_distance: bool) -> float:
        grid = Grid.of(mesh, Web(quarters, by_distance=by_distance))
        return _noise(pictures.loss(replace(mesh, vertices=grid.positions)))

    def least(room: float, *, by_distance: bool) -> int:
        """Return the fewest quarters that make no more noise than `room`."""
        low, high = _COARSEST, _FINEST
        while low < high:
            middle = (low + high) // 2
            low, high = (
                (low, middle) if noise(middle, by_distance=by_distance) <= room else (middle + 1, high)
            )
        return low

    ways = []
    others = _noise(pictures.loss(written(mesh, _style(Web(_FINEST, _LEVELS[-1]))))) if mesh.textures else 0.0
    for levels in _LEVELS if colors is not None else _LEVELS[:1]:
        room = _noise(LEAST) - others
        if colors is not None:
            shown = srgb_of(stored_light(colors, levels))
            room -= _noise(pictures.loss(replace(mesh, vertex_colors=shown)))
        for by_distance in (False, True) if is_unindexed(mesh.faces, len(mesh.vertices)) else (False,):
            web = Web(least(room, by_distance=by_distance), levels, by_distance)
            ways.append((web.quarters == _FINEST, len(_file(mesh, _style(web))), web))
    web = min(ways, key=lambda way: way[:2])[2]

    @cache
    def loss(quarters: int) -> float:
        return pictures.loss(written(mesh, _style(replace(web, quarters=quarters))))

    quarters = web.quarters
    while quarters > _COARSEST and loss(quarters - 1) >= LEAST:
        quarters -= 1
    while quarters < _FINEST and loss(quarters) < LEAST:
        quarters += 1
    said = f"{loss(quarters):.1f} dB of {pictures.said}, at {_SAMPLES} x {_SAMPLES} samples a pixel"
    return _style(replace(web, quarters=quarters)), said


def _noise(loss: float) -> float:
    """Return the mean square of what differs by `loss` dB."""
    return float(10 ** (-loss / 10))


def _style(web: Web) -> Style:
    return Style(texture="webp", web=web)


def as_glb(mesh: Mesh) -> Mesh:
    """Return `mesh` as a GLB holds it, but in its own coordinates."""
    from msb.meshes.assets import as_held

    return as_held(replace(mesh, up=None), ".glb")


def _file(mesh: Mesh, style: Style) -> bytes:
    from msb.meshes import write_mesh

    file = io.BytesIO()
    write_mesh(as_glb(mesh), file, suffix=".glb", style=style)
    return file.getvalue()


def written(mesh: Mesh, style: Style) -> Mesh:
    """Return what is read of `mesh` once it is written so."""
    from msb.meshes.source import Source

    return FORMATS[".glb"].read(Source("mesh.glb", _file(mesh, style)))
