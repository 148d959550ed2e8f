"""The causes of a worse look: how each is drawn, seen and mended."""

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
from msb.meshes.formats import written_suffixes
from msb.registry import lookup
from msb.render.frame import Frame
from msb.why.views import DoesNotApplyError, Image, Views

# A logit of opacity that is 1 to the last bit but a few.
_FULL = np.float32(20.0)
# Kernel of a coverage -> the settings at which it is 1 inside a face up to its edges, and 0 outside.
_HARD: dict[str, dict[str, float]] = {"gaussian_power": {"gamma": 1000.0}, "edge_window": {"sigma": 1e-9}}
# The same of Triangle-Splatting's stored sigma: the least that it can have is 0.01 + exp(-30).
_HARD_LOGARITHM = np.float32(-30.0)
_Pair = tuple[list[Any], list[Any]]
_Measure = Callable[[Views], _Pair]
# A changed model, and settings to draw it with.
_Change = tuple["Asset", dict[str, Any]]


def _supersampling(views: Views) -> _Pair:
    manifest = views.asset.manifest
    if views.samples:
        return views.own(settings=dict.fromkeys(views.samples, 1)), views.official
    if why_not(manifest, "dedicated") is None:
        raise DoesNotApplyError("its own renderer takes one sample a pixel, too")
    return views.plain.frames, views.plain.supersampled


def _shading(views: Views) -> _Pair:
    views.colored_mesh()
    return lit(views.plain.frames, views.light), views.plain.frames


def lit(frames: list[Frame], light: Image) -> list[Frame]:
    """Return frames as an engine's lamp lights them, `light` (F,) for each of their faces.

    Light dims sRGB values; a face has one normal, so that what is lit is what is drawn times its light.
    """
    dimmed = []
    for frame in frames:
        faces = frame.face_id
        assert faces is not None, "the standard tier says which face a pixel shows"
        image = np.where(faces[..., None] < 0, frame.image, frame.image * light[faces][..., None])
        dimmed.append(replace(frame, image=image))
    return dimmed


def _linear_colors(views: Views) -> _Pair:
    mesh = views.colored_mesh()
    if not mesh.textures:
        return taken_for_linear(views.plain.frames), views.plain.frames
    if mesh.vertex_colors is None and mesh.face_colors is None:
        raise DoesNotApplyError("its colours are textures, of which glTF itself says that they are sRGB")
    pale = replace(mesh, vertex_colors=_pale(mesh.vertex_colors), face_colors=_pale(mesh.face_colors))
    return views.of_mesh(pale), views.plain.frames


def taken_for_linear(frames: list[Frame]) -> list[Image]:
    """Return the images with one sRGB curve too many on what is no background."""
    return [
        np.where(frame.alpha[..., None] > 0, _srgb(np.clip(frame.image, 0, 1)), frame.image)
        for frame in frames
    ]


def _back_faces(views: Views) -> _Pair:
    return views.plain.culled, views.plain.frames


def _constant(asset: Asset) -> _Change:
    """Return `asset` in colours that are the same from everywhere."""
    if "sh_degree" not in lookup(asset.manifest.method).settings:
        raise DoesNotApplyError("its colours are not spherical harmonics that could be cut to a constant")
    if not effective_settings(asset.manifest)["sh_degree"]:
        raise DoesNotApplyError("its colours are the same from everywhere")
    return asset, {"sh_degree": 0}


def _opaque(asset: Asset) -> _Change:
    """Return `asset` with faces of opacity 1, but for those that its threshold hides."""
    if asset.manifest.opacity.get("encoding") != "logit" or "opacity" not in asset.buffers:
        raise DoesNotApplyError("its faces have no opacity of their own")
    stored = asset.buffers["opacity"]
    shown = visible_faces(asset, stored_threshold(asset))
    full = np.full_like(stored, _FULL)
    return _with(asset, opacity=full if shown is None else np.where(shown, full, stored)), {}


def _hard(asset: Asset) -> _Change:
    """Return `asset` with faces that cover all of their inside alike, and nothing else."""
    kernel = str(asset.manifest.coverage["kernel"])
    if kernel == "solid":
        raise DoesNotApplyError("its faces have hard edges already")
    if kernel == "incentre_window" and "sigma" in asset.buffers:
        return _with(asset, sigma=np.full_like(asset.buffers["sigma"], _HARD_LOGARITHM)), {}
    settings = _HARD.get(kernel, {})
    if not settings or settings.keys() - lookup(asset.manifest.method).settings.keys():
        raise DoesNotApplyError(f"how its coverage, {kernel}, is drawn with hard edges is not known")
    return asset, settings


def _without(change: Callable[[Asset], _Change]) -> _Measure:
    """Return how to measure what a change of the model costs in its own look."""

    def measure(views: Views) -> _Pair:
        asset, settings = change(views.asset)
        return views.own(asset, settings=settings), views.official

    return measure


def _with(asset: Asset, **buffers: NDArray[Any]) -> Asset:
    return replace(asset, buffers={**asset.buffers, **buffers})


def _exporter(views: Views) -> _Pair:
    ours = views.plain.frames
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
    return views.own(order="none"), views.official


def _pale(colors: NDArray[Any] | None) -> Image | None:
    """Return colours with one sRGB curve too many, and the alpha, if any, which cuts textures off."""
    if colors is None:
        return None
    values = colors.astype(np.float32) / np.float32(255 if colors.dtype == np.uint8 else 1)
    return np.concatenate((_srgb(values[:, :3]), values[:, 3:]), axis=1)


def _srgb(linear: Image) -> Image:
    """Return linear light as sRGB (IEC 61966-2-1), as an engine shows it."""
    curve = 1.055 * linear ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve).astype(np.float32)


# What an opaque mesh cannot have, whatever the engine: name of the cause -> the model without it.
BAKED: dict[str, Callable[[Asset], _Change]] = {
    "view_dependence": _constant,
    "opacity": _opaque,
    "soft_edges": _hard,
}


@dataclass(frozen=True)
class Known:
    """What is known of a cause before it is measured."""

    name: str
    title: str
    measure: _Measure
    how_to_see: str
    remedy: str


# Every cause, in the order in which they are shown.
CAUSES = (
    Known(
        "view_dependence",
        "View dependence dropped",
        _without(_constant),
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
        "msb convert writes linear light in .glb, as glTF has it, else sRGB; --color changes that.",
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
        _without(_opaque),
        "Faint faces stand before the surface as solid flakes.",
        "Blend with the stored opacity; or train with a term that makes it 0 or 1.",
    ),
    Known(
        "soft_edges",
        "Soft edges made hard",
        _without(_hard),
        "Faces end in a line where the render fades them out: splinters. msb compare shows both.",
        "Draw it with the method's own shader (docs/porting.md); or train with edges that end hard.",
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
