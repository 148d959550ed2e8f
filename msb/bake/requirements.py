"""Before any work, check the options of a bake for a model, and check that the required libraries are
installed."""

from dataclasses import replace

from msb.asset import Asset
from msb.asset.look import tint_of
from msb.asset.texture import textures_of
from msb.asset.tiers import why_not
from msb.bake.atlas import need_xatlas
from msb.bake.options import BakeOptions, ColorTarget, Geometry, need_libraries
from msb.bake.soup import is_uncut_soup
from msb.base.extras import is_installed, need_extra, need_extras
from msb.base.soup import is_soup
from msb.delivery.collision_kinds import parse_collision
from msb.topology import audit_arrays
from msb.topology.weld import weld_vertices

_BOX_HINT = "box needs no library"


def choose_color_target(options: BakeOptions, geometry: Geometry, asset: Asset) -> ColorTarget:
    """Return whether a geometry has its colours in a texture or at the vertices."""
    is_vertex = geometry == "kept" and options.texture is None and _fits_vertices(asset)
    return options.color or ("vertex" if is_vertex else "texture")


def check_model(options: BakeOptions, asset: Asset) -> None:
    """Reject options for this model that need a library that is not installed.

    Raises
    ------
    UsageError
        EXTRA_MISSING.
    """
    if asset.manifest.primitive == "gaussian" and options.geometry == "auto":
        need_libraries(replace(options, geometry="surface"))
        return
    points, faces = asset.buffers["positions"], asset.buffers["indices"]
    is_auto = options.geometry == "auto" and options.faces is None and not options.for_solid
    if is_auto or options.geometry == "kept":
        if choose_color_target(options, "kept", asset) == "texture" and not is_soup(faces):
            need_xatlas()
        if options.lod_shares and not is_uncut_soup(points, faces):
            need_extra("trial", "fast_simplification", what="a level of detail of a connected mesh")
    if options.collision is None or options.collision == "box":
        return
    kind, _ = parse_collision(options.collision)
    modules = ("fast_simplification", "coacd") if kind == "hulls" else ("fast_simplification",)
    # Kept triangles without a boundary stay closed, because the repair does not open holes. For every other
    # mesh, the collision shape is made from a closed surface around the mesh. If both steps lack an extra,
    # one error names both extras.
    is_open = options.geometry != "kept"
    if not is_open:
        welded = weld_vertices(points, faces, "exact")
        is_open = audit_arrays(*welded, check_crossings=False)[0].counts.boundary_edges > 0
    extras = {"trial": modules, "bench": ("skimage",) if is_open else ()}
    need_extras(extras, what=f"a collision mesh {options.collision}", instead=_BOX_HINT)


def need_enclosure() -> None:
    """Reject the enclosure of an open mesh if its library is not installed."""
    need_extra("bench", "skimage", what="a collision mesh of an open mesh", instead=_BOX_HINT)


def _fits_vertices(asset: Asset) -> bool:
    """Return whether vertex colours can show the colours of the model.

    Vertex colours cannot show colours that vary within a face, or uniform faces that share vertices. Without
    xatlas, models with shared vertices always get vertex colours, because only xatlas can make their texture.
    """
    if why_not(asset.manifest, "standard") is not None:
        return False
    tint = tint_of(asset)
    is_unshared = is_soup(asset.buffers["indices"])
    is_smooth = tint is not None and (is_unshared or tint.domain == "vertex")
    return (is_smooth and textures_of(asset) is None) or not (is_unshared or is_installed("xatlas"))
