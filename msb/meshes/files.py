"""The mesh formats by suffix, and the functions that read and write a mesh file."""

import os
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from msb.base.atomic import new_files
from msb.base.files import read_file
from msb.errors import InputError, MeshFileError, OutputError
from msb.meshes import gltf_scene, obj, off, ply, stl, usd
from msb.meshes.formats import FORMATS, Format, Style, written_suffixes
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source
from msb.meshes.transform import with_linear_colors
from msb.meshes.writing import check_writable

for _format in (ply.FORMAT, obj.FORMAT, off.FORMAT, stl.FORMAT, *gltf_scene.FORMATS, *usd.FORMATS):
    FORMATS.update(dict.fromkeys(_format.suffixes, _format))

# The suffixes of the files `read_mesh` knows, in lower case.
MESH_SUFFIXES = FORMATS.keys()
# Things that are named which a file holds and no reader keeps: it may name any number of them.
_MOST_LEFT_OUT = 16


def read_mesh(path: str | os.PathLike[str], *, images: bool = True) -> Mesh:
    """Read a mesh file exactly as stored: nothing is merged, split, dropped, reordered or repaired.

    Parameters
    ----------
    path : str or Path
        A regular file; the suffix, in any case, says the format.
    images : bool
        False for who needs the surface alone: images are not decoded, `textures` is empty, and texture
        coordinates are there wherever the file has some.

    Returns
    -------
    mesh : Mesh
        Polygons are cut into fans around their first corner; docs/meshes.md has the rules of each format.

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE (not a regular file, or no permission) or FILE_NOT_RECOGNISED.
    MeshFileError
        The content is not a valid file of its format: one of the MESH_FILE_ codes.
    MeshError
        MESH_INDEX_OUT_OF_RANGE, of a file of USD with colours by corner, whose vertices are doubled.

    Notes
    -----
    The file is untrusted. Declared sizes are checked against the file's before memory is taken. Of the paths
    in it (buffers and images of glTF, materials and images of OBJ) only regular files in its own folder or
    below it are opened: an absolute path, a scheme or host, "..", and a link to elsewhere are refused. Time
    and memory are linear in the size of these files.
    """
    name = os.fspath(path)
    try:
        source = Source(name, read_file(name), images=images)
        chosen = _known(name, Path(name).suffix)
        if not source.data:
            raise source.error("MESH_FILE_INVALID", "the file is empty")
        return _in_short(chosen.read(source))
    except MemoryError:
        message = "this machine has not enough memory for the file"
        raise MeshFileError("MESH_FILE_TOO_LARGE", message, file=name) from None


def _in_short(mesh: Mesh) -> Mesh:
    """Return `mesh` with the first of what is left out, and how much more that is."""
    first, more = mesh.left_out[:_MOST_LEFT_OUT], len(mesh.left_out) - _MOST_LEFT_OUT
    return mesh if more <= 0 else replace(mesh, left_out=(*first, f"{more:,} more things"))


def write_mesh(
    mesh: Mesh, target: str | os.PathLike[str] | BinaryIO, *, suffix: str, style: Style | None = None
) -> None:
    """Write a mesh; the same mesh gives the same bytes.

    Parameters
    ----------
    mesh : Mesh
        What to write. Every vertex row and face is kept, in order, as far as the format has them.
    target : str, Path or binary file
        Where to write. A path is overwritten; give a temporary name if a half-written file would be harmful.
    suffix : str
        One of `MESH_SUFFIXES`, in any case: the format. Some may be only read.
    style : Style, optional
        Whether colours are linear light, and what textures are packed as.

    Raises
    ------
    InputError
        FILE_NOT_RECOGNISED: no such format, or one that is only read.
    OutputError
        OUTPUT_FORMAT_LIMIT: the format cannot hold this mesh, or a coordinate that is not finite or too
        large. OUTPUT_UNWRITABLE: the path cannot be written. Errors of an open file are not translated.
    MeshError
        MESH_INDEX_OUT_OF_RANGE: a face uses a vertex that does not exist.
    """
    name = os.fspath(target) if isinstance(target, str | os.PathLike) else getattr(target, "name", suffix)
    chosen = _known(str(name), suffix)
    if chosen.write is None:
        message = f"{chosen.title} is only read; {' '.join(written_suffixes())} are written"
        raise InputError("FILE_NOT_RECOGNISED", message, file=str(name))
    check_writable(mesh)
    style = style or Style()
    if style.color == "linear" and not chosen.is_linear:
        mesh = with_linear_colors(mesh)
    if not isinstance(target, str | os.PathLike):
        chosen.write(mesh, target, style)
        return
    try:
        with Path(target).open("wb") as stream:
            chosen.write(mesh, stream, style)
    except OSError as error:
        message = f"it cannot be written: {error.strerror or error}"
        raise OutputError("OUTPUT_UNWRITABLE", message, file=name) from error


def beside(mesh: Mesh, path: Path, style: Style) -> dict[Path, bytes]:
    """Return the files that `write_whole` writes beside `path`, with what they hold."""
    form = _known(str(path), path.suffix)
    files = form.beside(mesh, replace(style, stem=path.stem)) if form.beside else {}
    return {path.with_name(name): content for name, content in files.items()}


def write_whole(mesh: Mesh, path: Path, style: Style | None = None, *, overwrite: bool = True) -> None:
    """Write a mesh and the files that it needs beside it, in the format of the suffix: all of them or none.

    Errors are those of `write_mesh` and of `new_files`.
    """
    style = replace(style or Style(), stem=path.stem)
    others = beside(mesh, path, style)
    with new_files([*others, path], overwrite=overwrite) as files:
        for file, content in zip(files[:-1], others.values(), strict=True):
            file.write(content)
        write_mesh(mesh, files[-1], suffix=path.suffix, style=style)


def _known(name: str, suffix: str) -> Format:
    """Return the format of `suffix`."""
    format_ = FORMATS.get(suffix.lower())
    if format_ is None:
        raise unknown_suffix(name, suffix)
    return format_


def unknown_suffix(name: str, suffix: str) -> InputError:
    """Return the error that the file `name`, which nothing else recognises, has no suffix of a mesh file."""
    what = f"'{suffix}' is not the suffix of a mesh file" if suffix else "it has no suffix"
    return InputError("FILE_NOT_RECOGNISED", f"{what}; {' '.join(MESH_SUFFIXES)} are read", file=name)
