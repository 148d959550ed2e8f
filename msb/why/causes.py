"""The causes of a loss of image quality.

For each cause, this module defines how to render, recognise and avoid it.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.adapters.official import official_exporter
from msb.asset import Asset
from msb.asset.look import stored_threshold, visible_faces
from msb.asset.settings import effective_settings
from msb.asset.tiers import why_not
from msb.errors import Unsupported
from msb.meshes import read_mesh
from msb.meshes.formats import list_written_suffixes
from msb.registry import lookup
from msb.render.frame import Frame
from msb.why.views import CauseViews, DoesNotApplyError, Image

# Logit of an opacity of 1 - 2e-9. In float32, this opacity rounds to 1.
_FULL_LOGIT = np.float32(20.0)
# For each coverage kernel, the settings for a coverage of 1 inside a face and 0 outside. The settings are a
# steep power and a narrow window.
_HARD_SETTINGS: dict[str, dict[str, float]] = {
    "gaussian_power": {"gamma": 1000.0},
    "edge_window": {"sigma": 1e-9},
}
# Stored value of Triangle-Splatting's sigma that makes edges hard. With this value, sigma = 0.01 + exp(value)
# has its minimum of 0.01.
_HARD_SIGMA = np.float32(-30.0)
# Two lists of images: the images without a cause, and the images with this cause. Each list of images has one
# image per view.
_Pair = tuple[list[Any], list[Any]]
_Draw = Callable[[CauseViews], _Pair]
# A changed model, and the settings for rendering it.
_Change = tuple[Asset, dict[str, Any]]


def _draw_supersampling(views: CauseViews) -> _Pair:
    """Compare images with one sample per pixel and images with several samples per pixel."""
    if views.samples:
        return views.draw_native(settings=dict.fromkeys(views.samples, 1)), views.native
    if why_not(views.asset.manifest, "dedicated") is None:
        raise DoesNotApplyError("the native renderer takes only one sample per pixel")
    return views.standard.frames, views.standard.supersampled


def _draw_shading(views: CauseViews) -> _Pair:
    """Compare a lit mesh with an unlit mesh."""
    views.colored_mesh()
    frames = views.standard.frames
    return apply_light(frames, views.light), frames


def apply_light(frames: list[Frame], light: Image) -> list[Frame]:
    """Return frames lit by an engine's light source; `light` (F,) is the brightness of each face.

    Each face has one normal. Therefore the lit image of a face is the unlit image times the brightness of the
    face. The multiplication uses sRGB values, as in engines.
    """
    lit = []
    # Multiply each pixel (H, W, 3) by the brightness of its face (H, W). The background has the face id -1.
    for frame in frames:
        faces = frame.face_id
        assert faces is not None, "only frames of the standard tier have face ids"
        image = np.where(faces[..., None] < 0, frame.image, frame.image * light[faces][..., None])
        lit.append(replace(frame, image=image))
    return lit


def _draw_linear_colors(views: CauseViews) -> _Pair:
    """Compare colours interpreted as linear light with correct colours."""
    mesh, frames = views.colored_mesh(), views.standard.frames
    if not mesh.textures:
        return interpret_as_linear(frames), frames
    if mesh.vertex_colors is None and mesh.face_colors is None:
        raise DoesNotApplyError("the colours are textures, which glTF defines as sRGB")
    # The engine misinterprets only the vertex or face colours, not the whole image. The mesh must therefore
    # be rendered again.
    pale = replace(mesh, vertex_colors=_encode(mesh.vertex_colors), face_colors=_encode(mesh.face_colors))
    return views.draw_mesh(pale), frames


def interpret_as_linear(frames: list[Frame]) -> list[Image]:
    """Return images of an engine that encodes sRGB colours as sRGB once more."""
    return [
        np.where(frame.alpha[..., None] > 0, _to_srgb(np.clip(frame.image, 0, 1)), frame.image)
        for frame in frames
    ]


def _draw_back_faces(views: CauseViews) -> _Pair:
    """Compare a mesh without its back faces with a two-sided mesh."""
    return views.standard.culled, views.standard.frames


def _without_view_dependence(asset: Asset) -> _Change:
    """Return `asset` with colours that do not depend on the view direction."""
    if "sh_degree" not in lookup(asset.manifest.method).settings:
        raise DoesNotApplyError(
            "the colours are not spherical harmonics, so msb cannot make the colours constant"
        )
    if not effective_settings(asset.manifest)["sh_degree"]:
        raise DoesNotApplyError("the colours do not depend on the view direction")
    return asset, {"sh_degree": 0}


def _with_full_opacity(asset: Asset) -> _Change:
    """Return `asset` with an opacity of 1 for all faces that its opacity threshold selects."""
    if asset.manifest.opacity.get("encoding") != "logit" or "opacity" not in asset.buffers:
        raise DoesNotApplyError("the faces have no opacity")
    stored = asset.buffers["opacity"]
    selected = visible_faces(asset, stored_threshold(asset))
    full = np.full_like(stored, _FULL_LOGIT)
    opacity = full if selected is None else np.where(selected, full, stored)
    return _with_buffers(asset, opacity=opacity), {}


def _with_hard_edges(asset: Asset) -> _Change:
    """Return `asset` with constant opacity up to the edges of each face, instead of soft edges."""
    kernel = str(asset.manifest.coverage["kernel"])
    if kernel == "solid":
        raise DoesNotApplyError("the faces have hard edges already")
    if kernel == "incentre_window" and "sigma" in asset.buffers:
        return _with_buffers(asset, sigma=np.full_like(asset.buffers["sigma"], _HARD_SIGMA)), {}
    settings = _HARD_SETTINGS.get(kernel, {})
    if not settings or settings.keys() - lookup(asset.manifest.method).settings.keys():
        raise DoesNotApplyError(f"hard edges are not implemented for the coverage {kernel}")
    return asset, settings


def _draw_change(change: Callable[[Asset], _Change]) -> _Draw:
    """Return a function that compares native renderings of the original and of a changed model."""

    def draw(views: CauseViews) -> _Pair:
        asset, settings = change(views.asset)
        return views.draw_native(asset, settings=settings), views.native

    return draw


def _with_buffers(asset: Asset, **buffers: NDArray[Any]) -> Asset:
    return replace(asset, buffers={**asset.buffers, **buffers})


def _draw_exporter(views: CauseViews) -> _Pair:
    """Compare the mesh of the method's official exporter with the mesh of msb."""
    ours = views.standard.frames
    try:
        exporter = official_exporter(views.asset.manifest.method)
    except Unsupported as error:
        raise DoesNotApplyError(error.message) from error
    suffix = next((suffix for suffix in exporter.SUFFIXES if suffix in list_written_suffixes()), None)
    if suffix is None:
        raise DoesNotApplyError("the official exporter writes no mesh file that engines can open")
    with tempfile.TemporaryDirectory(prefix="msb-why-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / f"official{suffix}"
        exporter.write(views.asset, path)
        theirs = read_mesh(path)
    return views.draw_mesh(theirs), ours


def _draw_unsorted(views: CauseViews) -> _Pair:
    """Compare images of faces drawn in stored order with images of faces sorted by depth."""
    if views.asset.manifest.compositing.get("kind") == "opaque_z_buffer":
        raise DoesNotApplyError("the mesh is drawn with a z-buffer, which needs no sorting")
    return views.draw_native(order="none"), views.native


def _encode(colors: NDArray[Any] | None) -> Image | None:
    """Return colours (N, 3 or 4) after one additional sRGB encoding.

    The alpha channel is not encoded, because it is not a colour.
    """
    if colors is None:
        return None
    # Bytes become floats in [0, 1].
    values = colors.astype(np.float32) / np.float32(255 if colors.dtype == np.uint8 else 1)
    return np.concatenate((_to_srgb(values[:, :3]), values[:, 3:]), axis=1)


def _to_srgb(linear: Image) -> Image:
    """Return linear light encoded as sRGB (IEC 61966-2-1)."""
    curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve).astype(np.float32)


# Causes that affect every opaque mesh in every engine. Each function removes one property of the model, for
# example the soft edges.
BAKED: dict[str, Callable[[Asset], _Change]] = {
    "view_dependence": _without_view_dependence,
    "opacity": _with_full_opacity,
    "soft_edges": _with_hard_edges,
}


@dataclass(frozen=True)
class CauseDefinition:
    """A cause of quality loss, with functions that draw images with and without the cause.

    `title`, `how_to_see` and `remedy` are printed. `how_to_see` explains how to recognise the cause in a
    program.
    """

    name: str
    title: str
    draw: _Draw
    how_to_see: str
    remedy: str


# All causes, in the order of reports.
CAUSES = (
    CauseDefinition(
        "view_dependence",
        "Colours independent of the view",
        _draw_change(_without_view_dependence),
        "Move around the model: highlights do not move over the surface. Compare with msb render --tier "
        "dedicated --set sh_degree=0.",
        "Evaluate all spherical harmonics in the shader, or bake colours for the important views.",
    ),
    CauseDefinition(
        "supersampling",
        "One sample per pixel",
        _draw_supersampling,
        "Zoom in: edges are jagged, and thin faces appear and disappear. Compare with msb render --tier "
        "dedicated --set supersample=1.",
        "Supersample by the factor used in training, or turn on multisampling.",
    ),
    CauseDefinition(
        "shading",
        "Lighting on",
        _draw_shading,
        "Turn off the engine's lights. If the image changes, the mesh is lit, although its colours already "
        "include the light of the scene.",
        "Use an unlit material; the GLB of msb convert requests one.",
    ),
    CauseDefinition(
        "linear_colors",
        "Colours interpreted as linear",
        _draw_linear_colors,
        "All colours are too pale or too dark. Compare in the page of msb web: set Colours to linear (glTF).",
        "Write the file with msb convert: .glb files get linear colours, as glTF specifies, all other files "
        "sRGB colours. For a program with other rules, set --color.",
    ),
    CauseDefinition(
        "back_faces",
        "Back faces culled",
        _draw_back_faces,
        "The surface has holes, which close when the camera moves to the other side.",
        "Make the material two-sided, or orient the faces consistently with msb repair.",
    ),
    CauseDefinition(
        "opacity",
        "Opacity ignored",
        _draw_change(_with_full_opacity),
        "Faint faces appear as solid flakes in front of the surface.",
        "Blend faces with the stored opacity, or train with a loss that makes opacities 0 or 1.",
    ),
    CauseDefinition(
        "soft_edges",
        "Soft edges drawn hard",
        _draw_change(_with_hard_edges),
        "Faces end abruptly, like splinters, and do not fade out. msb compare shows both renderings.",
        "Draw the model with the method's shader (docs/porting.md), or train with hard edges.",
    ),
    CauseDefinition(
        "exporter",
        "Official exporter instead of msb convert",
        _draw_exporter,
        "Write both files, msb convert ASSET a.ply and msb convert --official ASSET b.ply. Render each with "
        "msb render, and compare the images.",
        "Export with msb export and msb convert.",
    ),
    CauseDefinition(
        "engine_order",
        "Faces not sorted",
        _draw_unsorted,
        "Hidden surfaces shine through. Compare with msb render --tier dedicated --order none.",
        "Sort the faces by depth in every frame.",
    ),
)
