"""Reads files that a mesh file links to, and data that is embedded in URIs.

The linked files must be in the mesh file's folder or below.
"""

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
# The bytes of the linked files that were read. A key consists of a path and the largest number of bytes to
# read.
Files = dict[tuple[Path, int | None], bytes]


def read_uri(source: Source, uri: str, pointer: str, most: int | None, files: Files) -> bytes:
    """Return the bytes that a glTF `uri` refers to: embedded data (RFC 2397), or a linked file.

    The argument `most` limits the number of bytes. See `read_linked_file`. The argument `files` caches the
    linked files that were read.
    """
    embedded = _EMBEDDED.match(uri)
    if embedded is not None:
        try:
            data = unquote_to_bytes(uri[embedded.end() :])
            is_base64 = embedded[0].lower().endswith(";base64,")
            return base64.b64decode(data, validate=True) if is_base64 else data
        except ValueError:  # Lone surrogates also raise this error.
            raise source.error("MESH_FILE_INVALID", "the data is not valid base64", pointer=pointer) from None
    name = unquote(uri)
    key = resolve_linked_path(source, name, pointer), most
    if key not in files:
        files[key] = read_linked_file(source, name, pointer, most)
    return files[key]


def read_linked_file(source: Source, name: str, pointer: str, most: int | None) -> bytes:
    """Return the content of the file `name` in the folder of a mesh file.

    If the file is longer than `most` bytes, only `most` + 1 bytes are returned. The value None sets no limit.
    """
    place = resolve_linked_path(source, name, pointer)
    try:
        return read_file(place, most)
    except InputError as error:
        text = f"the linked file {shorten(name, 80)!r} cannot be read: {error.message}"
        raise source.error("MESH_FILE_INVALID", text, pointer=pointer) from None


def resolve_linked_path(source: Source, name: str, pointer: str) -> Path:
    """Return the resolved path of the file `name` in the folder of a mesh file.

    The file does not have to exist.

    Names that leave the folder are rejected: absolute paths, URLs, "..", and links to other folders.
    """
    short = shorten(name, 80)
    folder = Path(os.path.realpath(Path(source.path).parent))
    if why := _explain_invalid_name(name):
        text = f"{short!r} {why}; only files in the folder of the mesh, or below it, are read"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=pointer)
    place = Path(os.path.realpath(folder / name))
    if not place.is_relative_to(folder):
        text = f"{short!r} is a link to another folder; copy the file into the folder of the mesh"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=pointer)
    return place


def _explain_invalid_name(name: str) -> str | None:
    """Return the reason why `name` is not a file in the folder of the mesh or below.

    Return None if the name is valid.
    """
    if not name or "\0" in name or has_lone_surrogate(name):
        return "is not a file name"
    if _SCHEME.match(name):
        return "contains a scheme, a host or a drive"
    if name.startswith("/") or "\\" in name:
        return "is not a relative path with forward slashes"
    return "leaves the folder" if ".." in name.split("/") else None
