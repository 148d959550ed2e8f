"""Chooses the coarsest web encoding of a mesh that keeps an image quality of 50 dB.

A GLB for the web stores quantised positions, quantised colours and compressed textures. Quantised positions,
quantised colours and compressed textures each add an error to the images of the mesh. The mean squared errors
of independent steps add up approximately. The search therefore measures each compression step separately. A
PSNR of 50 dB allows a certain error, which is divided between the steps:

1. Measure the error of the compressed textures.

2. For each precision of the colours, measure the error of the colours. Subtract the errors of textures and
colours from the allowed error. By bisection, find the smallest number of position bits within the remaining
error.

3. Use the combination with the smallest file. Finally adjust the number of position bits until the whole file
has at least 50 dB.
"""

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

# Minimum PSNR in dB between images of a web file and of the original mesh. Image differences are invisible
# above about 40 dB.
MIN_PSNR = 50.0
# Samples per pixel along each axis of the compared images. With fewer samples, edges would dominate the
# error.
_SAMPLES = 4
# Search range for the precision of positions, in quarters of a bit: 10 to 22 bits.
_COARSEST, _FINEST = 40, 88
# Precisions of vertex colours (stored as linear light), from coarse to fine. With the value None, each
# channel is stored in one byte. A value is the largest allowed error of a byte, in levels of 8-bit sRGB. If
# the error of a byte is larger, the channel is stored in two bytes.
_LEVELS = (None, 4.0, 2.0, 1.0, 0.5)


@dataclass(frozen=True)
class ImageLoss:
    """Measures the difference between images of `mesh` and images of other meshes.

    `views` describes the cameras for messages. `why_not` is the reason why the images cannot be compared, or
    None.
    """

    mesh: Mesh
    cameras: list[Camera]
    views: str
    why_not: str | None = None
    # Cached images (H, W, 3) of `mesh`. The key is the number of samples per pixel along each axis.
    _images: dict[int, list[NDArray[np.float32]]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, mesh: Mesh, asset: Asset | None) -> ImageLoss:
        """Return the measurement for the mesh of `asset`, or for a mesh file without an asset."""
        from msb.meshes.assets import asset_from_mesh
        from msb.views import choose_views

        shown = asset or asset_from_mesh(mesh)
        chosen = choose_views(shown, count=4, size=(480, 360))
        cameras = chosen.cameras[:4]
        why_not = replace(chosen, cameras=cameras).without_blind(shown).why_not
        return cls(mesh, cameras, chosen.description, why_not)

    def loss(self, other: Mesh, samples: int = _SAMPLES) -> float:
        """Return the PSNR in dB of `other`, in images with `samples` samples per pixel along each axis."""
        from msb.views import psnr_over_views

        if samples not in self._images:  # cached, because a search compares these images with many meshes
            self._images[samples] = self._draw(self.mesh, samples)
        return psnr_over_views(self._images[samples], self._draw(other, samples))

    def _draw(self, mesh: Mesh, samples: int) -> list[NDArray[np.float32]]:
        from msb.views import render_standard

        return render_standard(mesh, self.cameras, supersample=samples)

    def describe(self, other: Mesh) -> str:
        """Return a text about the PSNR of `other` for the end of a sentence. The text is empty if the PSNR
        cannot be measured."""
        if self.why_not is not None:
            return ""
        try:
            return f" (PSNR {self.loss(other):.1f} dB, {self.views})"
        except DeviceError:
            return ""


def web_style(images: ImageLoss) -> tuple[Style, str]:
    """Return the coarsest web style that keeps 50 dB, and a text about the measured quality.

    If images cannot be compared, return the finest style. Images cannot be compared without an OpenCL device,
    or if the mesh covers too few pixels.
    """
    if images.why_not is not None:
        return _style(Web(_FINEST, _LEVELS[-1])), f"quality not measured ({images.why_not})"
    try:
        return _find_coarsest(images)
    except DeviceError:
        return _style(Web(_FINEST, _LEVELS[-1])), "quality not measured (no device)"


def _find_coarsest(images: ImageLoss) -> tuple[Style, str]:
    """Search for the style as described at the head of this module."""
    from msb.meshes.glb_web import Grid, convert_to_srgb, quantize_light

    mesh = as_glb(images.mesh)
    colors = mesh.vertex_colors

    @cache
    def position_error(quarters: int, *, by_distance: bool) -> float:
        grid = Grid.of(mesh, Web(quarters, by_distance=by_distance))
        return _squared_error(images.loss(replace(mesh, vertices=grid.positions)))

    def fewest_bits(room: float, *, by_distance: bool) -> int:
        """Return the lowest precision of positions with an error of at most `room`. The unit is 1/4 bit."""
        low, high = _COARSEST, _FINEST
        while low < high:
            middle = (low + high) // 2
            if position_error(middle, by_distance=by_distance) <= room:
                high = middle
            else:
                low = middle + 1
        return low

    # Measure the error of the textures. Use the finest positions and colours, which add almost no error.
    texture_error = 0.0
    if mesh.textures:
        finest = _style(Web(_FINEST, _LEVELS[-1]))
        texture_error = _squared_error(images.loss(encode_and_read(mesh, finest)))
    # Combine every precision of colours with the coarsest positions that the remaining error allows.
    candidates = []
    for levels in _LEVELS if colors is not None else _LEVELS[:1]:
        room = _squared_error(MIN_PSNR) - texture_error
        if colors is not None:
            rounded = convert_to_srgb(quantize_light(colors, levels))
            room -= _squared_error(images.loss(replace(mesh, vertex_colors=rounded)))
        # For a triangle soup, also try position steps that grow with the distance from its centre. This suits
        # captures.
        for by_distance in (False, True) if is_unindexed(mesh.faces, len(mesh.vertices)) else (False,):
            web = Web(fewest_bits(room, by_distance=by_distance), levels, by_distance)
            candidates.append((web.quarters == _FINEST, len(_encode(mesh, _style(web))), web))
    # Prefer candidates that do not need the finest precision. Among the remaining candidates, use the
    # candidate with the smallest file.
    web = min(candidates, key=lambda candidate: candidate[:2])[2]

    @cache
    def whole_loss(quarters: int) -> float:
        return images.loss(encode_and_read(mesh, _style(replace(web, quarters=quarters))))

    # Errors of separate steps add up only approximately, so adjust the precision of the positions at the end.
    quarters = web.quarters
    while quarters > _COARSEST and whole_loss(quarters - 1) >= MIN_PSNR:
        quarters -= 1
    while quarters < _FINEST and whole_loss(quarters) < MIN_PSNR:
        quarters += 1
    measured = f"PSNR {whole_loss(quarters):.1f} dB ({images.views}, {_SAMPLES**2} samples per pixel)"
    return _style(replace(web, quarters=quarters)), measured


def _squared_error(psnr: float) -> float:
    """Return the mean squared error at a PSNR in dB."""
    return float(10 ** (-psnr / 10))


def _style(web: Web) -> Style:
    return Style(texture="webp", web=web)


def as_glb(mesh: Mesh) -> Mesh:
    """Return `mesh` as it is read back from a GLB with this style. The result is in the original
    coordinates."""
    from msb.meshes.assets import fit_to_format

    return fit_to_format(replace(mesh, up=None, frame=None), ".glb")


def _encode(mesh: Mesh, style: Style) -> bytes:
    """Return the GLB of a mesh as bytes."""
    from msb.meshes import write_mesh

    file = io.BytesIO()
    write_mesh(as_glb(mesh), file, suffix=".glb", style=style)
    return file.getvalue()


def encode_and_read(mesh: Mesh, style: Style) -> Mesh:
    """Write `mesh` as a GLB in this style, read it again and return the result."""
    from msb.meshes.source import Source

    return FORMATS[".glb"].read(Source("mesh.glb", _encode(mesh, style)))
