"""USD: meshes of a stage, read and written by usd-core."""

from __future__ import annotations

import io
import re
import zipfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from msb.asset.texture import Sampler
from msb.base.children import run_apart
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import MeshFileError, about, shorten
from msb.meshes.beside import read_beside
from msb.meshes.colors import srgb_colors
from msb.meshes.formats import Format
from msb.meshes.image_files import images_of
from msb.meshes.images import MAX_FILE, Decoder
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source
from msb.meshes.usd_stage import stage_parts
from msb.meshes.usd_write import Kind, write
from msb.meshes.writing import check_indices

_SECONDS = 600.0
_PACKAGE = b"PK\x03\x04"
_MEMORY_PER_BYTE, _EXTRA_MEMORY = 64, 2.0
"""What usd-core may take: so many bytes per byte of the file, and so many GiB."""
_PLAIN = np.full((1, 1, 3), 255, np.uint8)


def read(source: Source) -> Mesh:
    """Return the meshes that a stage shows at its earliest time, where its transforms put them.

    usd-core reads the file, in a process of its own. A stage that is put together from several files is
    refused: only images are looked for beside it.
    """
    need_extra("usd", "pxr", what="a file of USD")
    _check_whole(source)
    memory = _EXTRA_MEMORY + _MEMORY_PER_BYTE * len(source.data) / 2**30
    # The process has another working directory.
    reply = run_apart(stage_parts, str(Path(source.path).absolute()), {}, Limits(_SECONDS, memory))
    if reply.why:
        code = "MESH_FILE_TOO_LARGE" if reply.ended_by in ("time", "memory") else "MESH_FILE_INVALID"
        raise source.error(code, f"usd-core cannot read it: {reply.why}")
    data, arrays = reply.data, reply.arrays
    if "refused" in data:
        raise source.error(*data["refused"])
    colors = {
        of: srgb_colors(arrays[f"{of}_colors"])
        for of in ("vertex", "face", "corner")
        if f"{of}_colors" in arrays
    }
    mesh = Mesh(
        arrays["vertices"],
        arrays["faces"],
        colors.get("vertex"),
        colors.get("face"),
        vertex_uvs=arrays.get("vertex_uvs"),
        corner_uvs=arrays.get("corner_uvs"),
        face_textures=arrays.get("face_textures"),
        left_out=tuple(data["left_out"]),
        up=data["up"],
    )
    if "corner" in colors:
        from msb.meshes.assets import with_corner_colors

        with about(source.path):
            check_indices(mesh)  # vertices are doubled here, and one that is not there cannot be
        mesh = with_corner_colors(mesh, colors["corner"])
    return _with_textures(mesh, source, data) if data["textures"] and source.images else mesh


def _check_whole(source: Source) -> None:
    """Refuse a package that is cut off: usd-core takes what it finds, without the end record."""
    is_package = _PACKAGE.startswith(source.data[: len(_PACKAGE)])
    if is_package and not zipfile.is_zipfile(io.BytesIO(source.data)):
        raise source.error("MESH_FILE_TRUNCATED", "the package's end record is missing: the file is cut off")


def _with_textures(mesh: Mesh, source: Source, data: dict[str, Any]) -> Mesh:
    """Return `mesh` with its images; the stage names them, or the package holds them."""
    decoder, images = Decoder(), []
    for name in data["textures"]:
        content = _image(source, name) if name else b""
        try:
            images.append(decoder.decode(content, alpha=data["cutoff"] is not None) if name else _PLAIN)
        except MeshFileError as error:
            raise source.error(error.code, f"image {shorten(name, 80)!r}: {error.message}") from None
    sampler = Sampler(wrap_u=data["wraps"][0], wrap_v=data["wraps"][1], alpha_cutoff=data["cutoff"])
    return replace(mesh, textures=tuple(images), sampler=sampler)


def _image(source: Source, name: str) -> bytes:
    """Return an image that a stage names, of the package or beside the file."""
    name = name.removeprefix("./")
    if not source.data.startswith(_PACKAGE):
        return read_beside(source, name, "a texture", MAX_FILE)
    try:
        with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
            about = archive.getinfo(name)
            # What is stored takes no more than the file; a package of USD has nothing compressed.
            if about.compress_type == zipfile.ZIP_STORED:
                return archive.read(about)
    except (KeyError, zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError):
        pass
    text = f"the package does not hold its image {shorten(name, 80)!r} as it is"
    raise source.error("MESH_FILE_INVALID", text)


def _format(title: str, suffixes: tuple[str, ...], kind: Kind, begins: bytes | None) -> Format:
    return Format(
        title,
        suffixes,
        read,
        partial(write, kind),
        begins=None if begins is None else re.compile(begins),
        beside=None if kind == "usdz" else images_of,
        keeps=("vertex_colors", "face_colors", "textures", "collision"),
        is_single=True,
        is_linear=True,
        up="+y",
    )


FORMATS = (
    _format("USD", (".usda",), "usda", rb"#usda"),
    _format("USD", (".usdc", ".usd"), "usdc", rb"PXR-USDC"),
    _format("USDZ", (".usdz",), "usdz", None),
)
