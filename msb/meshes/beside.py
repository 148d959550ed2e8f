"""What a mesh file names: files in its own folder or below it, and data that is written into the name."""

import base64
import os
import re
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

from msb.asset.strict_json import has_lone_surrogate
from msb.base.files import read_file
from msb.errors import InputError, shorten
from msb.meshes.source import Source

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")
_EMBEDDED = re.compile(r"data:[^,]{0,200},", re.IGNORECASE)
# Path of a file, and how many bytes of it were asked for -> what was read.
Files = dict[tuple[Path, int | None], bytes]


def read_uri(source: Source, uri: str, pointer: str, most: int | None, files: Files) -> bytes:
    """Return what a `uri` of glTF means: the data in it (RFC 2397), or the first bytes of a file beside.

    A file that is among `files` is not read again.
    """
    embedded = _EMBEDDED.match(uri)
    if embedded is not None:
        try:
            data = unquote_to_bytes(uri[embedded.end() :])
            is_base64 = embedded[0].lower().endswith(";base64,")
            return base64.b64decode(data, validate=True) if is_base64 else data
        except ValueError:  # half of a surrogate pair is one, too
            raise source.error("MESH_FILE_INVALID", "the data is not base64", pointer=pointer) from None
    name = unquote(uri)
    key = place_beside(source, name, pointer), most
    if key not in files:
        files[key] = read_beside(source, name, pointer, most)
    return files[key]


def read_beside(source: Source, name: str, pointer: str, most: int | None) -> bytes:
    """Return the first `most` bytes, or one more, of the file `name` beside a mesh file; None is all."""
    place = place_beside(source, name, pointer)
    try:
        return read_file(place, most)
    except InputError as error:
        text = f"it needs {shorten(name, 80)!r} in its folder, and that cannot be read: {error.message}"
        raise source.error("MESH_FILE_INVALID", text, pointer=pointer) from None


def place_beside(source: Source, name: str, pointer: str) -> Path:
    """Return the path, without links, of the file `name` beside a mesh file; it need not be there.

    Whatever leaves the folder is refused before it is looked at: an absolute name, a scheme or host, "..", a
    link to elsewhere.
    """
    shown = shorten(name, 80)
    folder = Path(os.path.realpath(Path(source.path).parent))
    if why := _why_not(name):
        text = f"{shown!r} {why}; only files in the folder of the mesh, or below it, are read"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=pointer)
    place = Path(os.path.realpath(folder / name))
    if not place.is_relative_to(folder):
        text = f"{shown!r} is a link that leaves the folder of the mesh; put the file itself there"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=pointer)
    return place


def _why_not(name: str) -> str | None:
    """Return why no file of this name can lie in the folder or below it."""
    if not name or "\0" in name or has_lone_surrogate(name):
        return "is no name of a file"
    if _SCHEME.match(name):
        return "names a scheme, a host or a drive"
    if name.startswith("/") or "\\" in name:
        return "is not a relative path with forward slashes"
    return "leaves the folder" if ".." in name.split("/") else None
