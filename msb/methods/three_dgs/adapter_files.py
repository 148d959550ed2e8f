"""Open the files of Gaussian splats: PLY, checkpoints, GLB, SOG, and raw byte formats."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.adapters.model import Content
from msb.adapters.tensors import Tensors
from msb.asset.strict_json import parse_strict_json
from msb.base.files import library_reason, map_file, read_file
from msb.errors import CheckpointError, MeshFileError, MsbError, about, shorten
from msb.meshes.gltf import Document, list_placed_meshes, open_document, parse_accessor, place_nodes
from msb.meshes.gltf_packed import unpack
from msb.meshes.gltf_parts import read_numbers
from msb.meshes.images import Decoder
from msb.meshes.ply_table import read_ply_tables
from msb.meshes.source import Source
from msb.splats import khronos, ply, rows, sog, spz
from msb.splats.gaussians import Gaussians, check_count, damaged, join

# Items of the tuple that a training stores in chkpntN.pth (graphdeco-inria/gaussian-splatting:
# scene/gaussian_model.py, capture): SH degree, means, f_dc, f_rest, scales, rotations, opacities, ...
_CAPTURED = 12
_META = "meta.json"
_MAX_META_BYTES = 1 << 22
# Maximum size of an image in a .sog file.
_MAX_IMAGE_BYTES = 1 << 30


def is_captured(value: Any) -> bool:
    """Return whether the value of a torch file is a checkpoint of 3DGS or 2DGS."""
    return (
        isinstance(value, tuple)
        and len(value) == 2
        and isinstance(value[0], tuple)
        and len(value[0]) == _CAPTURED
    )


def read_gaussians(content: Content) -> Gaussians:
    """Return the Gaussians of the file at a place.

    Raises
    ------
    CheckpointError, MeshFileError, InputError
        The file is damaged, or its kind is not supported.
    """
    with about(content.place.file):
        gaussians = _read(content)
        check_count(len(gaussians.mean))
    return gaussians


def _read(content: Content) -> Gaussians:
    place, suffix = content.place, content.place.file.suffix.lower()
    match place.kind:
        case "torch":
            return _read_captured(content)
        case "ply":
            return ply.read(*read_ply_tables(place.file))
        case "mesh":
            return _read_khronos(place.file)
        case "bundle":
            return _read_sog_folder(place.file)
    if suffix == ".sog":
        return _read_sog(place.file)
    if suffix == ".ksplat":
        text = "the .ksplat format is not read; convert it with npx @playcanvas/splat-transform "
        raise CheckpointError("CHECKPOINT_FORM", f"{text}{place.file.name} {place.file.stem}.ply")
    data = memoryview(map_file(place.file))
    return spz.read(data) if suffix == ".spz" else rows.read(data)


def _read_captured(content: Content) -> Gaussians:
    """Return the Gaussians of a training checkpoint."""
    keys = ("degree", "mean", "f_dc", "f_rest", "scale", "rotation", "opacity")
    values = dict(zip(keys, content.value[0], strict=False))
    tensors = Tensors(values, content.place.file, check_values=False)
    tensors.degree("f_rest", tensors.axis("f_rest", 1))
    rest = tensors.floats("f_rest", "N", "K", 3) if tensors.axis("f_rest", 1) else None
    return Gaussians(
        mean=tensors.floats("mean", "N", 3),
        scale=tensors.floats("scale", "N", 2 if tensors.axis("scale", 1) == 2 else 3),
        rotation=tensors.floats("rotation", "N", 4),
        opacity=tensors.floats("opacity", "N", 1)[:, 0],
        f_dc=tensors.floats("f_dc", "N", 1, 3)[:, 0],
        f_rest=rest,
    )


def _read_khronos(path: Path) -> Gaussians:
    """Return the Gaussians of all visible nodes of a GLB file."""
    document = open_document(Source(str(path), read_file(path)))
    nodes = place_nodes(document)
    placed = [mesh for mesh, is_hidden in list_placed_meshes(document, nodes) if not is_hidden]
    unpack(document, list(dict.fromkeys(entry.mesh for entry in placed)))
    parts, total = [], 0
    for entry in placed:
        mesh, pointer = document.entry("meshes", entry.mesh)
        for number, primitive in enumerate(document.array(mesh, "primitives", pointer)):
            where = f"{pointer}/primitives/{number}"
            extensions = (
                document.object(primitive, "extensions", where) if isinstance(primitive, dict) else {}
            )
            if khronos.EXTENSION not in extensions:
                continue
            _reject_compressed(document, extensions[khronos.EXTENSION], where)
            attributes = _read_attributes(document, primitive, where)
            total += sum(array.nbytes for array in attributes.values())
            document.check_total("the Gaussians of all scene nodes", total)
            parts.append(khronos.read(attributes, entry.world))
    if not parts:
        raise document.source.error("MESH_FILE_INVALID", "no visible node of the scene has Gaussians")
    return join(parts)


def _reject_compressed(document: Document, extension: Any, pointer: str) -> None:
    """Reject Gaussians whose attributes do not follow the base extension."""
    inner = extension.get("extensions") if isinstance(extension, dict) else None
    for name in inner if isinstance(inner, dict) else ():
        text = f"the Gaussians are stored with the extension {shorten(name)}, which is not supported; "
        raise document.error("MESH_FILE_UNSUPPORTED", pointer, f"{text}export without compression")


def _read_attributes(document: Document, primitive: dict[str, Any], pointer: str) -> dict[str, NDArray[Any]]:
    """Return the attributes (N, width) of a primitive, as defined by the extension, as numbers."""
    stored = document.object(primitive, "attributes", pointer)
    kinds = {**khronos.REQUIRED}
    kinds |= {khronos.coefficient(degree, k): "VEC3" for degree in range(4) for k in range(2 * degree + 1)}
    attributes = {}
    for name, kind in kinds.items():
        if name in stored:
            index = document.integer(stored, name, f"{pointer}/attributes")
            accessor = parse_accessor(document, index, kinds=kind, components="f4 i1 u1 i2 u2")
            attributes[name] = read_numbers(accessor)
    if len({len(array) for array in attributes.values()}) > 1:
        raise document.error("MESH_FILE_INVALID", pointer, "the Gaussian attributes have different lengths")
    return attributes


def _read_sog_folder(path: Path) -> Gaussians:
    """Return the Gaussians of a folder with meta.json and images; `path` is meta.json."""

    def read_member(name: str) -> bytes:
        if Path(name).name != name:
            raise damaged(f'the file name "{shorten(name)}" in {_META} points outside the folder')
        return read_file(path.parent / name, _MAX_IMAGE_BYTES)

    return _decode_sog(read_member)


def _read_sog(path: Path) -> Gaussians:
    """Return the Gaussians of a .sog file, which is a ZIP of the files of a folder."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_file(path))) as archive:

            def read_member(name: str) -> bytes:
                with archive.open(name) as member:
                    return member.read(_MAX_IMAGE_BYTES + 1)

            return _decode_sog(read_member)
    except MsbError:
        raise
    except Exception as error:  # the ZIP reader raises many exception types for damaged files
        raise damaged(f"the archive cannot be unpacked: {library_reason(error)}") from None


def _decode_sog(read_member: Callable[[str], bytes]) -> Gaussians:
    """Return the Gaussians of a SOG model, whose files `read_member` returns by name."""
    text = read_member(_META)
    meta = parse_strict_json(
        text,
        file=None,
        name=_META,
        max_bytes=_MAX_META_BYTES,
        error=CheckpointError,
        code="CHECKPOINT_LAYOUT",
    )
    decoder = Decoder()

    def read_image(name: str) -> NDArray[np.uint8]:
        try:
            return decoder.decode(read_member(name), alpha=True)
        except MeshFileError as error:
            raise damaged(f"{shorten(name)}: {error.message}") from None

    return sog.read(meta, read_image)
