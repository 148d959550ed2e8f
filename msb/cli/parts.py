"""Which files of a folder or beside a mesh belong to an input, and which a command wrote there."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from msb.base.files import is_file, map_file
from msb.errors import MsbError

if TYPE_CHECKING:
    import mmap

_DOCUMENT = re.compile(rb'[\s\[{]*"schema": "msb\.')
_TABLES = frozenset((".csv", ".html", ".vtp"))
"""Endings of what no input holds."""
_LOOKS = frozenset(
    ".exr .gif .glb .gltf .jpg .mp4 .npz .obj .off .pdf .png .stl .svg .triasset "  # noqa: SIM905
    ".usd .usda .usdc .usdz".split()
)
"""Endings of what is made of a model and is rarely a part of one, as PLY is."""
_NO_NAME_AFTER = re.compile(rb'([\w.-]|"name"\s*:\s*")\Z')
"""What stands before the end of a longer name, or before what glTF calls a picture that it holds."""


def own_place(path: Path) -> str:
    """Return where the file or link of that name itself lies."""
    return os.path.join(os.path.realpath(path.parent), path.name)  # noqa: PTH118 - one text an image


def is_made(path: Path, folder: Path) -> bool:
    """Return whether a file in an input is what a command wrote there: a document, or of a model a look."""
    from msb.adapters.locate import bare_models
    from msb.api.inputs import is_input

    ending = path.suffix.lower()
    if ending in _TABLES:
        return True
    if ending in _LOOKS and (is_input(folder) or bare_models(folder)):
        return not _is_of_model(path, folder)
    with contextlib.suppress(OSError), path.open("rb") as file:
        return _DOCUMENT.match(file.read(64)) is not None
    return False


def _is_of_model(path: Path, folder: Path) -> bool:
    """Return whether a file is a part of the model in a folder, by its name or as its mesh's texture."""
    from msb.adapters.locate import is_named, locate
    from msb.registry import METHODS

    if any(is_named(method, path) or path.name in method.bundle for method in METHODS.values()):
        return True
    with contextlib.suppress(MsbError):
        file = locate(folder).file
        # Only beside it, or a mesh were read again for each picture of a folder of pictures.
        return os.path.realpath(file.parent) == os.path.realpath(path.parent) and names(file, path)
    return False


def names(source: Path, other: Path) -> bool:
    """Return whether a mesh file, or a library of materials of it, names a file in its folder or below."""
    from msb.meshes import MESH_SUFFIXES

    ending = source.suffix.lower()
    if ending not in MESH_SUFFIXES or ending == ".usdz" or not is_file(source):  # .usdz holds its images
        return False
    if not Path(own_place(other)).is_relative_to(os.path.realpath(source.parent)):
        return False
    text = map_file(source)
    libraries = source.parent.glob("*.mtl") if ending == ".obj" else ()
    return _holds(text, other) or any(
        _holds(map_file(each), other) and _holds(text, each) for each in libraries
    )


def _holds(text: bytes | mmap.mmap, other: Path) -> bool:
    """Return whether a file's whole name stands in a text, as it is or as in a URI."""
    from urllib.parse import quote

    name = os.fsencode(other.name)
    for wanted in {name, quote(name).encode()} if other.suffix else ():
        place = text.find(wanted)
        while place >= 0:
            if not _NO_NAME_AFTER.search(text[max(place - 20, 0) : place]):
                return True
            place = text.find(wanted, place + 1)
    return False
