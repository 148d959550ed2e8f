"""Open an asset: check the manifest and the file sizes, and map the buffers without reading values."""

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.asset import Asset
from msb.asset.check import check_manifest, raise_first_error
from msb.asset.container import Container, is_asset, open_container
from msb.asset.manifest import DTYPES, Manifest
from msb.asset.strict_json import parse_strict_json
from msb.errors import AssetError, Finding, InputError, MsbError, finding

# Error codes that mean that the file is of another kind, such as a ZIP file of torch.
_NO_ASSET = ("FILE_NOT_RECOGNISED", "TRIASSET_MANIFEST_MISSING", "TRIASSET_FORM")


def load(path: str | os.PathLike[str]) -> Asset:
    """Open the `.triasset` at `path`, in packed or folder form.

    Opening takes milliseconds for an asset of any size, because only the manifest, paths and sizes are
    checked. `validate` also checks values and hashes. docs/triasset.md describes the format.

    Raises
    ------
    InputError
        The file does not exist or cannot be read; `FILE_NOT_RECOGNISED` if the file is not an asset.
        `msb.open` opens other kinds of files.
    AssetError
        The first finding with the severity "error".

    Examples
    --------
    >>> import msb
    >>> msb.load("data_stubs/splat_like.triasset").manifest.face_count
    34761
    """
    try:
        container = open_container(path)
        manifest_bytes = container.manifest_bytes()
    except MsbError as error:
        if error.code not in _NO_ASSET or is_asset(Path(path)):
            raise
        text = "it is not a .triasset; msb.open also opens checkpoints and mesh files"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path) from error
    findings, manifest = read_manifest(manifest_bytes, container)
    raise_first_error(findings, container.path)
    assert manifest is not None
    buffers = map_buffers(manifest, container)
    return Asset(manifest, buffers, container.path, tuple(findings), container.path)


def read_manifest(data: bytes, container: Container) -> tuple[list[Finding], Manifest | None]:
    """Check a manifest and its files. Return all findings, and the manifest if no finding is an error."""
    parsed = parse_strict_json(data, file=container.path)
    findings = check_manifest(parsed)
    if any(item.severity == "error" for item in findings):
        return findings, None
    manifest = Manifest.from_dict(parsed)
    findings += _check_files(manifest, container)
    return findings, None if any(item.severity == "error" for item in findings) else manifest


def _check_files(manifest: Manifest, container: Container) -> list[Finding]:
    """Return findings about missing buffer files, wrong file sizes, and additional files."""
    declared: dict[str, int] = {}
    for spec in manifest.buffers.values():
        declared[spec.file] = max(declared.get(spec.file, 0), spec.offset + spec.byte_length)
    findings: list[Finding] = []
    for file, wanted in declared.items():
        try:
            size = container.file_size(file)
        except AssetError as error:
            findings.append(finding(error.code, error.message, pointer=_pointer(manifest, file), file=file))
            continue
        if size != wanted:
            text = f"{file} has {size} bytes; the manifest declares {wanted}"
            findings.append(
                finding(
                    "TRIASSET_DAMAGED",
                    text,
                    pointer=_pointer(manifest, file),
                    file=file,
                    value=size,
                    limit=wanted,
                )
            )
    return findings + container.undeclared(set(declared))


def map_buffers(manifest: Manifest, container: Container) -> Mapping[str, NDArray[Any]]:
    """Return the buffers as read-only arrays in the mapped files."""
    arrays = {}
    for name, spec in manifest.buffers.items():
        view, start = container.map(spec.file)
        dtype = DTYPES[spec.dtype]
        flat = np.frombuffer(view, dtype, spec.byte_length // dtype.itemsize, start + spec.offset)
        flat.flags.writeable = False
        arrays[name] = flat.reshape(spec.shape)
    return MappingProxyType(arrays)


def _pointer(manifest: Manifest, file: str) -> str:
    """Return the JSON pointer of the first declaration of a file."""
    name = next(name for name, spec in manifest.buffers.items() if spec.file == file)
    return f"/buffers/{name}/file"
