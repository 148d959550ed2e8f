"""The causes of a worse look: how each is drawn, seen and mended."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.adapters.official import official_exporter
from msb.asset.look import daylight, up_axis
from msb.asset.tiers import why_not
from msb.errors import Unsupported
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import with_vertex_colors
from msb.meshes.formats import written_suffixes
from msb.methods import lookup
from msb.why.views import DoesNotApplyError, Views

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.why.views import Image

_FULL = np.float32(20.0)
"""A logit of opacity that is 1 to the last bit but a few."""
_Pair = tuple[list[Any], list[Any]]
_Measure = Callable[[Views], _Pair]


def _view_dependence(views: Views) -> _Pair:
    manifest = views.asset.manifest
    if "sh_degree" not in lookup(manifest.method).settings:
        raise DoesNotApplyError("its colours are not spherical harmonics that could be cut to a constant")
    if not manifest.sh_degree:
        raise DoesNotApplyError("its colours are the same from everywhere")
    return views.own(settings={"sh_degree": 0}), views.official()


def _supersampling(views: Views) -> _Pair:
    manifest = views.asset.manifest
    for name in ("supersample", "render_up_scale"):
        stored = manifest.settings.get(name)
        value = views.settings.get(name, None if stored is None else stored.value)
        if value is not None and value > 1:
            return views.own(settings={name: 1}), views.official()
    if why_not(manifest, "dedicated") is None:
        raise DoesNotApplyError("its own renderer takes one sample a pixel, too")
    return views.plain(), views.of_mesh(views.mesh(), supersample=4)


def _shading(views: Views) -> _Pair:
    mesh = with_vertex_colors(views.colored_mesh())
    colors = _floats(mesh.vertex_colors)[mesh.faces]
    lit = colors * daylight(mesh.vertices, mesh.faces, up_axis(views.asset))[:, None, None]
    corners = np.arange(mesh.faces.size, dtype=np.int64).reshape(-1, 3)
    shaded = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), corners, lit.reshape(-1, 3).astype(np.float32))
    return views.of_mesh(shaded), views.plain()


def _linear_colors(views: Views) -> _Pair:
    views.colored_mesh()
    twice = [
        np.where(frame.alpha[..., None] > 0, _srgb(np.clip(frame.image, 0, 1)), frame.image)
        for frame in views.plain()
    ]
    return twice, views.plain()


def _back_faces(views: Views) -> _Pair:
    mesh = views.mesh()
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    culled = []
    for camera in views.cameras:
        world_to_camera = np.asarray(camera.world_to_camera)
        eye = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
        front = ((eye - corners[:, 0]) * normal).sum(axis=1) > 0
        shown = replace(mesh, faces=mesh.faces[front], face_colors=_rows(mesh.face_colors, front))
        if front.any():
            one = Views(views.asset, [camera], views.background, {}, views.device)
            culled += [frame.image for frame in one.of_mesh(shown)]
        else:
            background = np.asarray(views.background, np.float32)
            culled.append(np.broadcast_to(background, (camera.height, camera.width, 3)))
    return culled, views.plain()


def _opacity(views: Views) -> _Pair:
    asset = views.asset
    if asset.manifest.opacity.get("encoding") != "logit" or "opacity" not in asset.buffers:
        raise DoesNotApplyError("its faces have no opacity of their own")
    opaque = {**asset.buffers, "opacity": np.full_like(asset.buffers["opacity"], _FULL)}
    return views.own(replace(asset, buffers=opaque)), views.official()


def _exporter(views: Views) -> _Pair:
    ours = views.plain()
    try:
        exporter = official_exporter(views.asset.manifest.method)
    except Unsupported as error:
        raise DoesNotApplyError(error.message) from error
    suffix = next((one for one in exporter.SUFFIXES if one in written_suffixes()), None)
    if suffix is None:
        raise DoesNotApplyError("its exporter writes no mesh that an engine opens by itself")
    with tempfile.TemporaryDirectory(prefix="msb-why-", ignore_cleanup_errors=True) as folder:
        place = Path(folder) / f"official{suffix}"
        exporter.write(views.asset, place)
        theirs = read_mesh(place)
    return views.of_mesh(theirs), ours


def _order(views: Views) -> _Pair:
    if views.asset.manifest.compositing.get("kind") == "opaque_z_buffer":
        raise DoesNotApplyError("a z-buffer draws it, which needs no order")
    return views.own(order="none"), views.official()


def _floats(colors: NDArray[Any] | None) -> Image:
    if colors is None:
        raise DoesNotApplyError("the mesh has no colours")
    values = colors[:, :3]
    return values.astype(np.float32) / np.float32(255 if values.dtype == np.uint8 else 1)


def _rows(values: NDArray[Any] | None, keep: NDArray[np.bool_]) -> NDArray[Any] | None:
    return None if values is None else values[keep]


def _srgb(linear: Image) -> Image:
    """Return linear light as sRGB (IEC 61966-2-1), as an engine shows it."""
    curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve).astype(np.float32)


@dataclass(frozen=True)
class Known:
    """What is known of a cause before it is measured. {set} in texts is the option that it is drawn with."""

    name: str
    title: str
    measure: _Measure
    how_to_see: str
    remedy: str


CAUSES = (
    Known(
        "view_dependence",
        "View dependence dropped",
        _view_dependence,
        "Walk around it: highlights stay where they are on the surface. msb render --tier dedicated --set "
        "sh_degree=0 draws it so.",
        "Evaluate all spherical harmonics in the shader, or bake colours for the views that matter.",
    ),
    Known(
        "supersampling",
        "Supersampling left out",
        _supersampling,
        "Zoom in: edges are stairs, and thin faces come and go. msb render --tier dedicated --set "
        "supersample=1 draws it so.",
        "Draw at the training's factor times the size and average, or turn multisampling on.",
    ),
    Known(
        "shading",
        "Shading on",
        _shading,
        "Turn the engine's lamps off: the picture changes. The colours hold the scene's light already.",
        "Use an unlit material, as the GLB of msb convert asks for.",
    ),
    Known(
        "linear_colors",
        "Colours taken for linear",
        _linear_colors,
        "All colours are too pale, or too dark. The page of msb web draws it so under Colours: as glTF.",
        "msb convert --color linear writes colours for engines that take vertex colours for linear light.",
    ),
    Known(
        "back_faces",
        "Back faces culled",
        _back_faces,
        "There are holes that close when the camera moves to the other side.",
        "Make the material two-sided, or wind faces alike with msb repair.",
    ),
    Known(
        "opacity",
        "Opacity dropped",
        _opacity,
        "Faint faces stand before the surface as solid flakes.",
        "Blend with the stored opacity; or train with a term that makes it 0 or 1.",
    ),
    Known(
        "exporter",
        "The method's own exporter instead of msb convert",
        _exporter,
        "Draw both files: msb convert ASSET a.ply, msb convert --official ASSET b.ply, msb render each.",
        "Export with msb export and msb convert.",
    ),
    Known(
        "engine_order",
        "Faces drawn unsorted",
        _order,
        "Surfaces behind others shine through. msb render --tier dedicated --order none draws it so.",
        "Sort faces by depth in each frame.",
    ),
)
"""Every cause, in the order in which they are shown."""
