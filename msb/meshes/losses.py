"""What a mesh file that is written does not have of its source."""

from collections.abc import Iterator, Sequence

import numpy as np

from msb.asset import Asset
from msb.asset.look import shown_faces, stored_threshold
from msb.asset.texture import Sampler
from msb.meshes.formats import FORMATS
from msb.meshes.mesh import Mesh

# Buffer of an asset that a mesh file has no place for -> what it is.
_UNWRITTEN = {"opacity": "opacity", "sigma": "soft edges (sigma)"}


def beyond_a_mesh(asset: Asset) -> list[str]:
    """Return what the standard-tier mesh of `asset` does not have."""
    manifest, beyond = asset.manifest, []
    if manifest.sh_degree:
        beyond.append(f"colours that change with the view (SH degree {manifest.sh_degree})")
    beyond += [what for name, what in _UNWRITTEN.items() if name in asset.buffers]
    shown = shown_faces(asset, stored_threshold(asset))
    if shown is not None:
        beyond.append(f"{manifest.face_count - len(shown):,} faces that the STE threshold hides")
    return beyond


def why_split(suffix: str) -> str:
    """Return why files of `suffix` split what shares vertices, and which do not."""
    soup = FORMATS[suffix].is_soup
    reason = "repeats the vertices of every face" if soup else "holds no colours of faces"
    return f"{suffix} {reason}: {_keeping_face_colors()} keep the merged mesh"


def _keeping_face_colors() -> str:
    names = [name for name, each in FORMATS.items() if "face_colors" in each.keeps and each.write]
    return f"{', '.join(names)} and .triasset"


def losses(mesh: Mesh, written: Mesh, suffix: str, left_out: Sequence[str]) -> Iterator[str]:
    """Yield what is lost between `mesh` and `written`, and what of the source was `left_out` before."""
    form = FORMATS[suffix]
    doubles = not np.array_equal(written.faces, mesh.faces)
    if doubles and form.is_soup:
        yield f"{suffix} repeats the vertices of every face: it is a soup again until they are merged"
    elif doubles and mesh.face_colors is not None and written.face_colors is None:
        yield (
            f"{suffix} holds no colours of faces: vertices are doubled where these differ; "
            f"{_keeping_face_colors()} keep them"
        )
    if suffix == ".obj" and mesh.textures and mesh.sampler != Sampler(alpha_cutoff=mesh.sampler.alpha_cutoff):
        yield f"how its textures are filtered and repeated, {suffix} cannot say"
    # UVs that no texture needs are no part of a look, but a GLB has them all the same.
    lost = [each for each in left_out if each != "UVs" or not _has_uvs(written)]
    if not form.keeps and mesh.textures:
        lost.append(f"textures, which {suffix} has no place for")
    elif not form.keeps and (mesh.vertex_colors is not None or mesh.face_colors is not None):
        lost.append(f"colours, which {suffix} has no place for")
    if lost:
        yield f"left out: {', '.join(lost)}"


def left_behind(mesh: Mesh, engine: str) -> Iterator[str]:
    """Yield what `engine` does not hold of `mesh`, or not as it was."""
    if engine == "godot" and mesh.vertex_colors is not None:
        yield "godot keeps vertex colours in eight bits of linear light, which is coarse where it is dark"
    if engine == "blender" and mesh.textures and mesh.sampler.mipmaps:
        yield "blender reads textures without mip maps"
    if engine == "web":
        yield "rows of vertices and faces are in another order"


def _has_uvs(mesh: Mesh) -> bool:
    return mesh.vertex_uvs is not None or mesh.corner_uvs is not None


def what_is_up(mesh: Mesh, suffix: str, *, known: bool) -> Iterator[str]:
    """Yield what became of up where a format fixes it but it is not `known`, or cannot say it."""
    if FORMATS[suffix].up is None:
        if known and mesh.up not in (None, "+y"):
            yield f"{mesh.up} is up in it, which {suffix} cannot say; msb convert --up={mesh.up} turns it"
    elif mesh.up is None:
        yield "what is up is not known, so nothing is turned: msb convert --up=-y if it comes from COLMAP"
    elif not known:
        yield f"what is up is not known and taken to be {mesh.up}; msb convert --up says otherwise"
