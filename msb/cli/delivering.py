"""`msb convert --for`: the file that an engine opens as it comes, and what pictures lose by it."""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

from msb.errors import DeviceError
from msb.meshes.formats import FORMATS, Style, Web

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from msb.asset import Asset
    from msb.cli.convert import Engine
    from msb.cli.output import Output
    from msb.meshes import Mesh
    from msb.render import Frame
    from msb.scenes import Camera

LEAST = 50.0
"""dB to the asset that a file for the web keeps, in pictures of four samples a pixel each way."""
_SAMPLES = 4
_COARSEST, _FINEST = 12, 22
"""Bits of positions, of which the fewest are taken that keep so much; the last are about those of float32."""


def left_behind(mesh: Mesh, engine: Engine) -> Iterator[str]:
    """Yield what `engine` does not hold of `mesh`."""
    if engine == "godot" and mesh.vertex_colors is not None:
        yield "godot keeps vertex colours in eight bits of linear light, which is coarse where it is dark"
    if engine == "blender" and mesh.textures and mesh.sampler.mipmaps:
        yield "blender reads textures without mip maps"
    if engine == "web":
        yield "rows of vertices and faces are in another order"


@dataclass(frozen=True)
class Pictures:
    """How much meshes differ from one of an asset in the views that judge it."""

    mesh: Mesh
    cameras: list[Camera]
    said: str
    _own: dict[int, list[Frame]] = field(default_factory=dict, repr=False)
    """Samples a pixel each way -> the pictures of `mesh`."""

    @classmethod
    def of(cls, mesh: Mesh, asset: Asset | None) -> Pictures:
        """Return those of `mesh`; without an asset it is a file's."""
        from msb.meshes.assets import asset_from_mesh
        from msb.views import choose_views

        chosen = choose_views(asset or asset_from_mesh(mesh), count=4, size=(480, 360))
        return cls(mesh, chosen.cameras[:4], chosen.said)

    def loss(self, other: Mesh, samples: int = _SAMPLES) -> float:
        """Return the PSNR in dB of `other`, with so many samples a pixel each way."""
        from msb.why.views import difference

        if samples not in self._own:  # a search asks often
            self._own[samples] = self._drawn(self.mesh, samples)
        return difference(self._own[samples], self._drawn(other, samples))

    def _drawn(self, mesh: Mesh, samples: int) -> list[Frame]:
        from msb.meshes.assets import asset_from_mesh
        from msb.render import Renderer

        with Renderer(asset_from_mesh(mesh), "standard", supersample=samples) as renderer:
            return [renderer.render(camera) for camera in self.cameras]

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
        return Style(texture="webp", web=Web(_FINEST, True)), "not measured, as nothing can draw here"


def _coarsest(pictures: Pictures) -> tuple[Style, str]:
    @cache
    def loss(web: Web) -> float:
        return pictures.loss(written(pictures.mesh, Style(texture="webp", web=web)))

    fine = loss(Web(_FINEST, False)) < LEAST + 2
    low, high = _COARSEST, _FINEST
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if loss(Web(middle, fine)) >= LEAST else (middle + 1, high)
    said = f"{loss(Web(low, fine)):.1f} dB of {pictures.said}, at {_SAMPLES} x {_SAMPLES} samples a pixel"
    return Style(texture="webp", web=Web(low, fine)), said


def write_held(held: Mesh, target: Path, output: Output, style: Style | None = None) -> None:
    """Write a mesh with the files that it needs beside it, none of which may be there without --force."""
    from msb.meshes.files import beside, write_whole

    for other in beside(held, target, style or Style()):
        output.check_free(other)
    write_whole(held, target, style)


def written(mesh: Mesh, style: Style) -> Mesh:
    """Return what is read of `mesh` once it is written so."""
    from msb.meshes import write_mesh
    from msb.meshes.assets import as_held
    from msb.meshes.source import Source

    file = io.BytesIO()
    write_mesh(as_held(replace(mesh, up=None), ".glb"), file, suffix=".glb", style=style)
    return FORMATS[".glb"].read(Source("mesh.glb", file.getvalue()))
