"""The standard look: the static colours of an asset, and which faces are shown.

The renderer, the engines, `msb convert` and the viewers all use this rule to draw or write the opaque mesh.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from msb.asset.activation import sigmoid
from msb.asset.asset import Asset
from msb.asset.drawable import required_buffer
from msb.asset.sh import SH_C0
from msb.asset.texture import Textured, linear_to_srgb, sample, srgb_to_linear, textures_of

# The colour, in all three channels, of a mesh that brings none, where light falls on it at right angles.
GREY = 0.8
# The part of the light on it that comes from everywhere.
AMBIENT = 0.35
# Where the rest comes from: above, a little from the front and right; along (right, up, front).
_LIGHT = (0.36, 0.8, 0.48)
# Axis -> the two others, in the order of a right-handed frame.
_AXES = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}
# Faces whose normals are made together.
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class StaticColors:
    """Colours of the standard tier: values (n, 3) or (n, 4), uint8, or float32 in [0, 1].

    A fourth channel is not drawn.
    """

    values: NDArray[Any]
    domain: Literal["vertex", "face", "corner"]


def static_colors(buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str]) -> StaticColors | None:
    """Return the colours that `buffers` bring, or clamp(C0 f_dc + 0.5, 0, 1); None if there are neither.

    Each colour is clamped before anything is interpolated (paper, "Standard deployment"). `domains` are
    those of the buffers; "color" is taken before "f_dc".
    """
    for name in ("color", "f_dc"):
        if name in buffers:
            values = baked_colors(buffers[name]) if name == "f_dc" else clamped(buffers[name])
            return StaticColors(values, cast("Any", domains[name]))
    return None


def colors_of(asset: Asset) -> StaticColors | None:
    """Return the `static_colors` of an asset; of one with textures what they show at its corners."""
    textured = textures_of(asset)
    if textured is None:
        return tint_of(asset)
    return corner_colors(textured, tint_of(asset), asset.buffers["indices"])


def tint_of(asset: Asset) -> StaticColors | None:
    """Return the `static_colors` of an asset, which are multiplied with its textures if it has any."""
    return static_colors(asset.buffers, {name: spec.domain for name, spec in asset.manifest.buffers.items()})


def corner_colors(textured: Textured, tint: StaticColors | None, indices: NDArray[Any]) -> StaticColors:
    """Return the sRGB colours (3F, 3) float32 of the corners: what the textures show there, times `tint`.

    What draws no textures draws these. `indices` are the faces (F, 3).
    """
    made = np.zeros((textured.uvs.size // 2, 4), np.float32)
    faces = len(textured.uvs)
    shown = np.zeros(faces, np.uint32) if textured.face_texture is None else textured.face_texture
    for number, image in enumerate(textured.images):
        rows = np.repeat(shown == number, 3)
        made[rows] = sample([image], textured.uvs.reshape(-1, 2)[rows], textured.sampler)
    if tint is not None:
        made *= corner_tint(tint, indices)
    return StaticColors(np.clip(linear_to_srgb(made[:, :3]), 0, 1), "corner")


def corner_tint(tint: StaticColors, indices: NDArray[Any]) -> NDArray[np.float32]:
    """Return colours as linear light and alpha (3F, 4) float32 at the corners of the faces (F, 3)."""
    values = tint.values if tint.values.dtype == np.float32 else tint.values / np.float32(255)
    made = np.ones((len(values), 4), np.float32)
    made[:, : values.shape[1]] = values
    made[:, :3] = srgb_to_linear(made[:, :3])
    if tint.domain == "corner":
        return made
    return np.repeat(made, 3, axis=0) if tint.domain == "face" else made[indices.reshape(-1)]


def drawn_colors(asset: Asset) -> StaticColors:
    """Return the colours `asset` is drawn in: its `static_colors`, or grey that is lit."""
    colors = colors_of(asset)
    if colors is not None:
        return colors
    grey = lit_grey(asset.buffers["positions"], asset.buffers["indices"], up_axis(asset))
    return StaticColors(grey, "face")


def lit_grey(vertices: NDArray[Any], faces: NDArray[Any], axis: str) -> NDArray[np.float32]:
    """Return the colours (F, 3) of a mesh that brings none: `GREY` in `daylight`."""
    shade = GREY * daylight(vertices, faces, axis)
    return np.repeat(shade.astype(np.float32)[:, None], 3, axis=1)


def daylight(vertices: NDArray[Any], faces: NDArray[Any], axis: str) -> NDArray[np.float64]:
    """Return the brightness (F,) of each face of a plain surface in daylight; `axis`, such as "+y", is up.

    It is a + (1 - a) |n . l|: n is the face's normal, l the direction of the light, a the ambient part. Both
    sides are alike, because winding need not be consistent. Faces without a normal have a alone.
    """
    facing, light = np.zeros(len(faces)), light_toward(axis)
    for here, _, normals in normals_of(vertices, faces):
        length = np.linalg.norm(normals, axis=1)
        np.divide(np.abs(normals @ light), length, out=facing[here], where=length > 0)
    return np.asarray(AMBIENT + (1 - AMBIENT) * facing)


def normals_of(
    vertices: NDArray[Any], faces: NDArray[Any]
) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[np.float64]]]:
    """Yield which faces, their first corners (n, 3), and their normals (n, 3), twice their areas long.

    They are few enough for the cache: the first touch of new memory takes longer than all the arithmetic.
    """
    for start in range(0, len(faces), _AT_ONCE):
        here = slice(start, start + _AT_ONCE)
        corners = np.asarray(vertices[faces[here]], np.float64)
        sides = corners[:, 1:] - corners[:, :1]
        yield here, corners[:, 0], np.cross(sides[:, 0], sides[:, 1])


def light_toward(axis: str) -> NDArray[np.float64]:
    """Return the unit vector (3,) towards the light of `daylight`, for what is up."""
    front, right = _AXES[axis[1]]
    up = "xyz".index(axis[1])
    sign = -1.0 if axis[0] == "-" else 1.0
    light = np.zeros(3)
    light[[right, up, front]] = (_LIGHT[0], sign * _LIGHT[1], sign * _LIGHT[2])
    return np.asarray(light / np.linalg.norm(light))


def up_axis(asset: Asset) -> str:
    """Return the axis of `asset` that points up, such as "+y"."""
    return known_up(asset.manifest.coordinate_frame.up, asset.manifest.method)


def written_up(asset: Asset) -> str | None:
    """Return the axis that points up in a mesh made of `asset`: as pages take it, but None of a mesh file."""
    frame, method = asset.manifest.coordinate_frame, asset.manifest.method
    return frame.known_up if method == "mesh" else known_up(frame.up, method)


def known_up(stored: str, method: str | None) -> str:
    """Return the axis that points up: as `stored`; if that is unknown, +y of a mesh file (method None or
    "mesh"), as glTF has it, and -y of a trained scene, as COLMAP has it.
    """
    if stored != "unknown":
        return stored
    return "+y" if method in (None, "mesh") else "-y"


def baked_colors(f_dc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return clamp(C0 f_dc + 0.5, 0, 1), the colour of the zeroth SH coefficient."""
    return clamped(np.float32(SH_C0) * f_dc + np.float32(0.5))


def clamped(colors: NDArray[Any]) -> NDArray[Any]:
    """Return float colours clamped to [0, 1], byte colours unchanged; NaN, which drawing refuses, stays."""
    return np.clip(colors, np.float32(0), np.float32(1)) if colors.dtype.kind == "f" else colors


def visible_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.bool_] | None:
    """Return a mask (F,) of the faces that an STE threshold leaves; None if there is no threshold or opacity.

    A face is shown if its opacity is above the threshold, both in float32, as in the official code
    (GaodeRender/triangle-splatting). The standard tier reads opacity for nothing else. Where
    it is not of faces, `TRIASSET_BUFFER` refuses it.
    """
    if ste_threshold is None or "opacity" not in asset.buffers:
        return None
    opacity = required_buffer(asset, "opacity", asset.manifest.face_count)
    return np.asarray(sigmoid(opacity) > np.float32(ste_threshold))


def shown_faces(asset: Asset, ste_threshold: float | None) -> NDArray[np.uint32] | None:
    """Return the numbers of the `visible_faces`, in ascending order; None if that is all of them."""
    shown = visible_faces(asset, ste_threshold)
    return None if shown is None or shown.all() else np.flatnonzero(shown).astype(np.uint32)


def stored_threshold(asset: Asset) -> float | None:
    """Return the STE threshold that `asset` was exported with."""
    stored = asset.manifest.settings.get("ste_threshold")
    return None if stored is None else cast("float | None", stored.value)
