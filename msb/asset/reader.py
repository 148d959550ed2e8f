"""Open an asset: check everything that costs milliseconds, map the buffers, read no values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.asset.check import check_manifest
from msb.asset.container import Container, is_asset, open_container
from msb.asset.manifest import DTYPES, Manifest
from msb.asset.strict_json import parse_strict_json
from msb.errors import AssetError, Finding, InputError, MsbError, finding

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True, repr=False, eq=False)
class Asset:
    """A manifest and its buffers.

    Attributes
    ----------
    manifest : Manifest
        The manifest's keys as attributes.
    buffers : mapping of str to ndarray
        Read-only arrays of the declared shape and dtype; of a loaded asset, views of the mapped file.
    path : Path or None
        Where it was loaded from; None if it was built in memory.
    warnings : tuple of Finding
        What `load` noticed and tolerated.

    Notes
    -----
    Whoever computes with the values checks them first: `load` does not read them. The mapping lives as
    long as an array refers to it. If another program shortens the file meanwhile, touching the lost pages
    ends the process, as with any memory mapping.

    `copy.copy` shares the arrays and so the mapping. `copy.deepcopy` and `pickle` take the values along:
    such a copy needs no file, and as much memory as its buffers have bytes. A process on the same machine
    is better sent the path. `path` stays what it was.
    """

    manifest: Manifest
    buffers: Mapping[str, NDArray[Any]]
    path: Path | None = None
    warnings: tuple[Finding, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        # A mappingproxy is neither pickled nor copied, and arrays come back writable.
        return _restored, (self.manifest, dict(self.buffers), self.path, self.warnings)

    def __repr__(self) -> str:
        m = self.manifest
        where = "in memory" if self.path is None else str(self.path)
        return f"<Asset {m.method}, {m.vertex_count} vertices, {m.face_count} faces, {where}>"


def _restored(
    manifest: Manifest, buffers: dict[str, NDArray[Any]], path: Path | None, warnings: tuple[Finding, ...]
) -> Asset:
    """Return the asset of these parts, its buffers read-only."""
    views = {name: array.view() for name, array in buffers.items()}
    for view in views.values():
        view.flags.writeable = False
    return Asset(manifest, MappingProxyType(views), path, warnings)


_NO_ASSET = ("FILE_NOT_RECOGNISED", "TRIASSET_MANIFEST_MISSING", "TRIASSET_ZIP_NAME")
"""What is found in a file or folder that is no asset, among them what torch saved, a ZIP as well."""


def load(path: str | os.PathLike[str]) -> Asset:
    """Open the `.triasset` at `path`, packed or folder.

    Takes milliseconds whatever the size: the manifest, all paths and all sizes are checked, values and
    hashes are not (`validate` does). Format: docs/triasset.md.

    Raises
    ------
    InputError
        If there is no such asset or it cannot be read; `FILE_NOT_RECOGNISED` if it is something else, which
        `msb.open` may know.
    AssetError
        With the code of the first finding whose severity is "error".

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
        text = "it is no .triasset; msb.open takes checkpoints and mesh files, too"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path) from error
    data = parse_strict_json(manifest_bytes, file=container.path)
    found = check_manifest(data)
    _raise_first(found, container)
    manifest = Manifest.from_dict(data)
    found += check_files(manifest, container)
    _raise_first(found, container)
    return Asset(manifest, map_buffers(manifest, container), container.path, tuple(found))


def check_files(manifest: Manifest, container: Container) -> list[Finding]:
    """Return findings about the files behind the buffers: each there, of the declared size, none besides."""
    declared: dict[str, int] = {}
    for spec in manifest.buffers.values():
        declared[spec.file] = max(declared.get(spec.file, 0), spec.offset + spec.byte_length)
    found: list[Finding] = []
    for file, wanted in declared.items():
        try:
            size = container.file_size(file)
        except AssetError as error:
            found.append(finding(error.code, error.message, pointer=_pointer(manifest, file), file=file))
            continue
        if size != wanted:
            code = "TRIASSET_BUFFER_TRUNCATED" if size < wanted else "TRIASSET_BUFFER_TOO_LONG"
            text = f"{file} has {size} bytes; the manifest declares {wanted}"
            found.append(
                finding(code, text, pointer=_pointer(manifest, file), file=file, value=size, limit=wanted)
            )
    return found + container.undeclared(set(declared))


def map_buffers(manifest: Manifest, container: Container) -> Mapping[str, NDArray[Any]]:
    """Return the buffers as read-only arrays on the container's mapping; their files have been checked."""
    arrays = {}
    for name, spec in manifest.buffers.items():
        view, start = container.map(spec.file)
        dtype = DTYPES[spec.dtype]
        flat = np.frombuffer(view, dtype, spec.byte_length // dtype.itemsize, start + spec.offset)
        flat.flags.writeable = False
        arrays[name] = flat.reshape(spec.shape)
    return MappingProxyType(arrays)


def _pointer(manifest: Manifest, file: str) -> str:
    name = next(name for name, spec in manifest.buffers.items() if spec.file == file)
    return f"/buffers/{name}/file"


def _raise_first(found: list[Finding], container: Container) -> None:
    for item in found:
        if item.severity == "error":
            raise item.to_error(container.path)
