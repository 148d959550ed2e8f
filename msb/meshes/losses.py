"""Describes the information that is lost when a mesh is written to a file."""

from collections.abc import Iterator, Sequence

import numpy as np

from msb.asset import Asset
from msb.asset.look import select_faces, stored_threshold
from msb.asset.texture import Sampler
from msb.base.origin import NO_ORIGIN, describe_origin, find_origin, round_coordinates
from msb.meshes.formats import FORMATS
from msb.meshes.mesh import Mesh, describe_rounding

# Maps asset buffers that no mesh format can store to descriptions.
_UNWRITTEN = {"opacity": "opacity", "sigma": "soft edges (sigma)"}


# Formats that cause no note about losses.
_WITHOUT_COMMENTS = (".stl", ".off")


def list_dropped_features(asset: Asset) -> list[str]:
    """Return descriptions of all data in `asset` that its standard-tier mesh does not contain."""
    manifest, beyond = asset.manifest, []
    if manifest.sh_degree:
        beyond.append(f"view-dependent colours (SH degree {manifest.sh_degree})")
    beyond += [what for name, what in _UNWRITTEN.items() if name in asset.buffers]
    visible = select_faces(asset, stored_threshold(asset))
    if visible is not None:
        beyond.append(f"{manifest.face_count - len(visible):,} faces with an opacity below the STE threshold")
    return beyond


def explain_split(suffix: str) -> str:
    """Return the reason why files of `suffix` split merged vertices. Also name formats that keep vertices
    merged."""
    soup = FORMATS[suffix].is_soup
    reason = "stores separate vertices for every face" if soup else "cannot store face colours"
    return f"{suffix} {reason}; use {_list_face_color_formats()} to keep vertices merged"


def _list_face_color_formats() -> str:
    """Return a text with the suffixes of formats with face colours."""
    names = [name for name, form in FORMATS.items() if "face_colors" in form.keeps and form.write]
    return f"{', '.join(names)} or .triasset"


def list_losses(
    mesh: Mesh, written: Mesh, suffix: str, left_out: Sequence[str], image_loss: str = ""
) -> Iterator[str]:
    """The mesh `written` is stored in a file of `suffix`. Yield a note for each loss, compared with `mesh`.

    The argument `left_out` lists parts of the source that were already missing in `mesh`. The text
    `image_loss` is appended to the note about textures that became vertex colours.
    """
    form = FORMATS[suffix]
    is_split = not np.array_equal(written.faces, mesh.faces)
    if is_split and form.is_soup:
        yield (
            f"{suffix} stores separate vertices for every face (a triangle soup); merge the vertices "
            "after reading"
        )
    elif is_split and mesh.face_colors is not None and written.face_colors is None:
        yield (
            f"{suffix} cannot store face colours: vertices are split where colours differ; "
            f"use {_list_face_color_formats()} to keep face colours"
        )
    if mesh.textures and not written.textures and written.vertex_colors is not None:
        yield f"{suffix} has no textures; they were converted to vertex colours{image_loss}"
    if suffix == ".obj" and mesh.textures and mesh.sampler != Sampler(alpha_cutoff=mesh.sampler.alpha_cutoff):
        yield f"{suffix} cannot store texture filtering and wrapping"
    if form.is_single:
        yield from _describe_coordinates(mesh, written, suffix)
    # `left_out` contains the names of UVs that belong to no texture. A GLB file still stores these UVs.
    lost = [part for part in left_out if part != "UVs" or not _has_uvs(written)]
    lost += form.list_lost(written) if form.list_lost else []
    lost += _list_lost_parts(mesh, written, suffix)
    if not form.keeps and mesh.textures:
        lost.append(f"textures ({suffix} cannot store them)")
    if not form.keeps and (mesh.vertex_colors is not None or mesh.face_colors is not None):
        lost.append(f"colours ({suffix} cannot store them)")
    if lost:
        yield f"not written: {', '.join(lost)}"


def _describe_coordinates(mesh: Mesh, written: Mesh, suffix: str) -> Iterator[str]:
    """Yield notes about the coordinates in a file of `suffix`, which are float32."""
    if any(stored := find_origin(written.vertices)):
        yield f"coordinates are float32 relative to {describe_origin(stored)}, the translation of the mesh"
    origin = find_origin(mesh.vertices) if FORMATS[suffix].has_origin else NO_ORIGIN
    if (loss := describe_rounding(mesh, round_coordinates(mesh.vertices, origin))) is not None:
        yield f"{loss}; use {_list_exact_formats()} to keep the exact coordinates"


def _list_exact_formats() -> str:
    """Return a text with the suffixes of formats that store the coordinates of any mesh exactly."""
    names = [name for name, form in FORMATS.items() if form.write and not form.is_single]
    return " or ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _list_lost_parts(mesh: Mesh, written: Mesh, suffix: str) -> Iterator[str]:
    """Yield names of the cut-outs, colours and UVs of `mesh` that are missing in `written`."""
    has_cut_outs = mesh.textures and mesh.sampler.alpha_cutoff is not None
    if has_cut_outs and FORMATS[suffix].keeps and not written.textures:
        yield f"cut-outs ({suffix} cannot store them)"
    has_both = mesh.face_colors is not None and mesh.vertex_colors is not None
    if has_both and FORMATS[suffix].keeps and "face_colors" not in FORMATS[suffix].keeps:
        yield "face colours, because vertex colours take precedence"
    if _has_uvs(mesh) and not mesh.textures and not _has_uvs(written):
        yield f"UVs ({suffix} cannot store them)"


def list_engine_losses(mesh: Mesh, engine: str) -> Iterator[str]:
    """Yield a note for each property of `mesh` that the program `engine` loses or changes."""
    if engine == "godot" and mesh.vertex_colors is not None:
        yield "Godot stores vertex colours as 8-bit linear light, which is coarse in dark areas"
    if engine == "blender" and mesh.textures and mesh.sampler.mipmaps:
        yield "Blender does not use mip maps"
    if engine == "web":
        yield "vertices and faces are reordered"


def _has_uvs(mesh: Mesh) -> bool:
    return mesh.vertex_uvs is not None or mesh.corner_uvs is not None


def describe_placement(written: Mesh, suffix: str) -> Iterator[str]:
    """Yield a note if the format of `suffix` cannot record the rotation or scale of `written`."""
    if written.placement is not None and suffix in _WITHOUT_COMMENTS:
        yield (
            f"{suffix} cannot record the rotation and the unit, so cameras of the capture do not match "
            "the file"
        )


def describe_up_axis(mesh: Mesh, suffix: str, *, known: bool) -> Iterator[str]:
    """Yield a note if the up axis is not `known`, or if the format cannot store the up axis."""
    if FORMATS[suffix].up is None:
        if known and mesh.up not in (None, "+y"):
            yield f"{mesh.up} is up, which {suffix} cannot store; msb convert --up={mesh.up} rotates it to +y"
    elif mesh.up is None:
        yield "the up axis is unknown, so the mesh is not rotated; for COLMAP scenes use msb convert --up=-y"
    elif not known:
        yield f"the up axis is unknown; {mesh.up} is assumed. Pass --up to msb convert to change it"
