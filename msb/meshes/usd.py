"""Reads USD meshes with usd-core, and declares the USD formats."""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import MAX_TEXTURES, Sampler, linear_to_srgb, srgb_to_linear
from msb.base.children import run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.base.seam_keys import hash_attributes
from msb.errors import MeshFileError, about, shorten
from msb.meshes.charts import without_textures
from msb.meshes.colors import clamp_floats, srgb_colors
from msb.meshes.formats import Format
from msb.meshes.images import MAX_FILE, Decoder
from msb.meshes.linked_files import read_linked_file
from msb.meshes.mesh import Mesh
from msb.meshes.placement import take_back
from msb.meshes.source import Source
from msb.meshes.usd_looks import encode_used_images, list_lost, list_stored
from msb.meshes.usd_stage import read_stage
from msb.meshes.usd_write import Kind, write
from msb.meshes.writing import check_indices

# Time limit of usd-core in seconds.
_SECONDS = 600.0
_PACKAGE = b"PK\x03\x04"
# Memory limit of usd-core: 64 bytes per byte of the file, plus 2 GiB.
_MEMORY_PER_BYTE, _EXTRA_MEMORY = 64, 2.0
_PLAIN = np.full((1, 1, 3), 255, np.uint8)


def read(source: Source) -> Mesh:
    """Return the visible meshes of a stage at its earliest time, in world coordinates in metres.

    usd-core reads the file in a child process. Stages composed of several files are rejected. Only images may
    be separate files.
    """
    need_extra("usd", "pxr", what="a USD file")
    _check_whole(source)
    memory = _EXTRA_MEMORY + _MEMORY_PER_BYTE * len(source.data) / 2**30
    # The path is absolute, because the child process has a different working directory.
    reply = run_in_child(read_stage, str(Path(source.path).absolute()), {}, Limits(_SECONDS, memory))
    if reply.why:
        code = "MESH_FILE_TOO_LARGE" if reply.ended_by in ("time", "memory") else "MESH_FILE_INVALID"
        raise source.error(code, f"usd-core cannot read the file: {reply.why}")
    data, arrays = reply.data, reply.arrays
    if "refused" in data:
        raise source.error(*data["refused"])
    colors = {
        domain: srgb_colors(clamp_floats(arrays[f"{domain}_colors"]))
        for domain in ("vertex", "face", "corner")
        if f"{domain}_colors" in arrays
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
        meters_per_unit=data["meters_per_unit"],
    )
    if "corner" in colors:
        from msb.meshes.assets import with_corner_colors

        with about(source.path):
            check_indices(mesh)  # Check the indices before vertices are split.
        mesh = with_corner_colors(mesh, colors["corner"])
    if "corner_normals" in arrays:
        mesh = replace(mesh, corner_keys=hash_attributes([arrays["corner_normals"]]))
    mesh = _with_textures(mesh, source, data) if data["textures"] and source.images else mesh
    try:
        frame = json.loads(data["frame"] or "null")
    except (ValueError, RecursionError):
        frame = None
    return take_back(mesh, frame)


def _check_whole(source: Source) -> None:
    """Reject truncated packages, because usd-core accepts packages without the end record of the archive."""
    is_package = _PACKAGE.startswith(source.data[: len(_PACKAGE)])
    if is_package and not zipfile.is_zipfile(io.BytesIO(source.data)):
        raise source.error("MESH_FILE_TRUNCATED", "the file is truncated: the package has no end record")


def _with_textures(mesh: Mesh, source: Source, data: dict[str, Any]) -> Mesh:
    """Return `mesh` with its images, which are in the package or in separate files.

    Images that cannot be read are listed in `left_out`. Faces with these images are white.
    """
    uses, decoder = data["textures"], Decoder()
    if len(uses) > MAX_TEXTURES:
        text = f"the stage has {len(uses)} textures; at most {MAX_TEXTURES} are supported"
        raise source.error("MESH_FILE_TOO_LARGE", text)
    images, missing = [_PLAIN] * len(uses), []
    for number, use in enumerate(uses):
        if use is None:
            continue
        try:
            texels = decoder.decode(_read_image(source, use["file"]), alpha=use["has_alpha"])
            images[number] = _adjust_texels(texels, use)
        except MeshFileError as error:
            missing.append(f"image {shorten(use['file'], 60)} ({shorten(error.message, 200)})")
    mesh = replace(mesh, left_out=(*mesh.left_out, *dict.fromkeys(missing)))
    if all(image is _PLAIN for image in images):
        return without_textures(mesh)
    sampler = Sampler(wrap_u=data["wraps"][0], wrap_v=data["wraps"][1], alpha_cutoff=data["cutoff"])
    return replace(mesh, textures=tuple(images), sampler=sampler)


def _adjust_texels(image: NDArray[np.uint8], use: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return `image` as sRGB texels (H, W, 3 | 4).

    The argument `use` has the fields of `msb.meshes.usd_materials.ImageUse`.
    """
    scale, bias = use["scale"], use["bias"]
    if not use["is_raw"] and (set(scale), set(bias)) == ({1.0}, {0.0}):
        return image
    # Build a table of all 256 levels for each channel. For each level: convert the level to linear light,
    # scale and shift it, and convert it back.
    levels, channels = np.arange(256) / 255, []
    for channel in range(image.shape[-1]):
        is_linear = channel == 3
        light = levels if is_linear or use["is_raw"] else srgb_to_linear(levels)
        light = np.clip(light * scale[channel] + bias[channel], 0, 1)
        table = np.rint((light if is_linear else linear_to_srgb(light)) * 255).astype(np.uint8)
        channels.append(table[image[..., channel]])
    return np.stack(channels, axis=-1)


def _read_image(source: Source, name: str) -> bytes:
    """Return the image called `name`, from the package or from the folder of the file."""
    name = name.removeprefix("./")
    if not source.data.startswith(_PACKAGE):
        return read_linked_file(source, name, "a texture", MAX_FILE)
    try:
        with zipfile.ZipFile(io.BytesIO(source.data)) as archive:
            about = archive.getinfo(name)
            # USD packages are not compressed. An image in a package therefore cannot be larger than the file.
            if about.compress_type == zipfile.ZIP_STORED:
                return archive.read(about)
    except (KeyError, zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError):
        pass
    text = f"the package does not contain the image {shorten(name, 80)!r} uncompressed"
    raise source.error("MESH_FILE_INVALID", text)


def _declare_format(title: str, suffixes: tuple[str, ...], kind: Kind, begins: bytes | None) -> Format:
    """Return the format for one type of USD file."""
    return Format(
        title,
        suffixes,
        read,
        partial(write, kind),
        begins=None if begins is None else re.compile(begins),
        companions=None if kind == "usdz" else encode_used_images,
        keeps=("vertex_colors", "face_colors", "normals", "textures", "collision"),
        list_stored=list_stored,
        list_lost=list_lost,
        is_single=True,
        has_origin=True,
        is_linear=True,
        up="+y",
    )


FORMATS = (
    _declare_format("USD", (".usda",), "usda", rb"#usda"),
    _declare_format("USD", (".usdc", ".usd"), "usdc", rb"PXR-USDC"),
    _declare_format("USDZ", (".usdz",), "usdz", None),
)
