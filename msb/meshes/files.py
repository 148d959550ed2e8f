"""The mesh formats by suffix, and the functions that read and write a mesh file."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from msb.base.atomic import new_files
from msb.base.files import read_file
from msb.errors import InputError, MeshFileError, OutputError
from msb.meshes import gltf_scene, obj, off, ply, stl, usd
from msb.meshes.formats import FORMATS, OURS, Format, Style, list_written_suffixes
from msb.meshes.mesh import Mesh
from msb.meshes.placement import find_comment, take_back
from msb.meshes.source import Source
from msb.meshes.transform import with_linear_colors
from msb.meshes.writing import check_writable

for _format in (ply.FORMAT, obj.FORMAT, off.FORMAT, stl.FORMAT, *gltf_scene.FORMATS, *usd.FORMATS):
    OURS.update(dict.fromkeys(_format.suffixes, _format))

# The suffixes that `read_mesh` accepts, in lower case, including the formats of other packages.
MESH_SUFFIXES = FORMATS.keys()
# Maximum number of entries in `Mesh.left_out`, the list of ignored data. Later entries are only counted,
# because a malicious file may have millions of entries.
_MAX_LEFT_OUT = 16


def read_mesh(path: str | os.PathLike[str], *, images: bool = True) -> Mesh:
    """Read a mesh file exactly as stored: no data is merged, split, dropped, reordered or repaired.

    Parameters
    ----------
    path : str or Path
        A regular file. The suffix of the path, in upper or lower case, selects the format.
    images : bool
        Whether to decode texture images. If False, texture images are skipped. Texture coordinates are always
        read.

    Returns
    -------
    mesh : Mesh
        Polygons are split into triangles, see `msb.meshes.polygons`. docs/meshes.md has the rules of each
        format.

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE (not a regular file, or no permission) or FILE_NOT_RECOGNISED.
    MeshFileError
        The content is invalid: one of the MESH_FILE_ codes.
    MeshError
        `MESH_INDEX_OUT_OF_RANGE`: a USD file with colours per corner has an invalid vertex index. Meshes of
        all other formats are returned with their invalid indices.

    Notes
    -----
    The file is not trusted. Declared sizes are compared with the file size before memory is allocated.
    Linked files are buffers and images of glTF, and materials and images of OBJ. Linked files are
    only opened if they are regular files in the same folder or below. Absolute paths, URLs, ".." and links to
    other folders are rejected. Time and memory are linear in the size of the read files.
    """
    name = os.fspath(path)
    try:
        source = Source(name, read_file(name), images=images)
        chosen = _find_format(name, Path(name).suffix)
        if not source.data:
            raise source.error("MESH_FILE_INVALID", "the file is empty")
        return take_back(_shorten_left_out(chosen.read(source)), find_comment(source.data))
    except MemoryError:
        message = "not enough memory to read the file"
        raise MeshFileError("MESH_FILE_TOO_LARGE", message, file=name) from None


def _shorten_left_out(mesh: Mesh) -> Mesh:
    """Return `mesh` with a shortened `left_out`. The list contains the first entries and the number of other
    entries.
    """
    first, more = mesh.left_out[:_MAX_LEFT_OUT], len(mesh.left_out) - _MAX_LEFT_OUT
    return mesh if more <= 0 else replace(mesh, left_out=(*first, f"{more:,} more properties"))


def write_mesh(
    mesh: Mesh, target: str | os.PathLike[str] | BinaryIO, *, suffix: str, style: Style | None = None
) -> None:
    """Write a mesh file. Equal meshes always give equal bytes.

    Parameters
    ----------
    mesh : Mesh
        The mesh. Vertices and faces keep their order as far as the format allows.
    target : str, Path or binary file
        The destination. An existing file is overwritten in place, so an error may leave a partial file.
    suffix : str
        The format: one of `MESH_SUFFIXES`, in upper or lower case.
    style : Style, optional
        Colour space, image format and other options.

    Raises
    ------
    InputError
        FILE_NOT_RECOGNISED: the format is unknown or read-only.
    OutputError
        OUTPUT_FORMAT_LIMIT: the format cannot store this mesh, or a coordinate is not finite or is too large.
        OUTPUT_UNWRITABLE: the path cannot be written. Errors of an open stream are raised unchanged.
    MeshError
        MESH_INDEX_OUT_OF_RANGE: a face uses a vertex that does not exist.
    """
    name = os.fspath(target) if isinstance(target, str | os.PathLike) else getattr(target, "name", suffix)
    chosen = _find_format(str(name), suffix)
    if chosen.write is None:
        message = f"{chosen.title} files cannot be written; use one of {' '.join(list_written_suffixes())}"
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
        message = f"the file cannot be written: {error.strerror or error}"
        raise OutputError("OUTPUT_UNWRITABLE", message, file=name) from error


def companion_files(mesh: Mesh, path: Path, style: Style) -> dict[Path, bytes]:
    """Return the additional files that `write_whole` writes for `path`, as a mapping from path to content."""
    form = _find_format(str(path), path.suffix)
    files = form.companions(mesh, replace(style, stem=path.stem)) if form.companions else {}
    return {path.with_name(name): content for name, content in files.items()}


def write_whole(
    mesh: Mesh,
    path: Path,
    style: Style | None = None,
    *,
    overwrite: bool = True,
    check_companion: Callable[[Path], None] = lambda path: None,
) -> None:
    """Write a mesh and its additional files in the format of the suffix.

    Either all files are written or no file is written.

    Before anything is written, the function `check_companion` may reject the path of an additional file.
    Raises the errors of `write_mesh` and `new_files`.
    """
    style = replace(style or Style(), stem=path.stem)
    companions = companion_files(mesh, path, style)
    for companion in companions:
        check_companion(companion)
    with new_files([*companions, path], overwrite=overwrite) as files:
        for file, content in zip(files[:-1], companions.values(), strict=True):
            file.write(content)
        write_mesh(mesh, files[-1], suffix=path.suffix, style=style)


def _find_format(name: str, suffix: str) -> Format:
    """Return the format of `suffix`."""
    format_ = FORMATS.get(suffix.lower())
    if format_ is None:
        raise make_suffix_error(name, suffix)
    return format_


def make_suffix_error(name: str, suffix: str) -> InputError:
    """Return the error for the file `name` with an unknown suffix."""
    what = f"'{suffix}' is not a mesh file suffix" if suffix else "the file has no suffix"
    return InputError("FILE_NOT_RECOGNISED", f"{what}; use one of {' '.join(MESH_SUFFIXES)}", file=name)
