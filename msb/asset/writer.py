"""Write an asset atomically. Equal content gives equal bytes in the file."""

import os
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Literal, get_args

from msb.asset.asset import Asset
from msb.asset.build import CHUNK_BYTES, as_bytes
from msb.asset.check import check_manifest, raise_first_error
from msb.asset.manifest import ALIGNMENT, DTYPES, MANIFEST_NAME
from msb.asset.progress import Meter, Progress
from msb.asset.reader import load
from msb.asset.strict_json import MAX_BYTES
from msb.base.atomic import folder_is_taken, new_file, new_folder
from msb.base.files import is_folder
from msb.errors import AssetError, MsbError, UsageError, shorten

Form = Literal["packed", "folder"]
FORMS: tuple[str, ...] = get_args(Form)
# Sizes of a local header and of its ZIP64 record, in bytes.
_LOCAL_HEADER = 30
_ZIP64_EXTRA = 20
# Id of padding in the extra field, which Android's zipalign also uses. Readers skip unknown ids.
_PADDING_ID = 0xD935
_EPOCH = (1980, 1, 1, 0, 0, 0)
# Members of at least this size in bytes get a ZIP64 record.
_ZIP64_FROM = 1 << 30


def write_asset(
    asset: Asset,
    path: str | os.PathLike[str],
    form: Form = "packed",
    *,
    overwrite: bool = True,
    progress: Progress | None = None,
) -> None:
    """Write a `.triasset` to `path`. An existing file is replaced when the new file is complete.

    Parameters
    ----------
    asset : Asset
    path : path-like
    form : {"packed", "folder"}
        "packed" is a single file, a ZIP of stored members that are aligned to 64 bytes.
    overwrite : bool
        Whether an existing file may be replaced. An existing folder is replaced only if it contains an asset.
    progress : callable, optional
        Called as ``progress("writing", done, total)`` with bytes.
    """
    _check_readable(asset, path)
    size = sum(spec.byte_length for spec in asset.manifest.buffers.values())
    meter = Meter("writing", size, progress)
    if form == "folder":
        if overwrite:
            check_asset_folder(Path(path))
        with new_folder(path, size=size, overwrite=overwrite) as folder:
            for name, chunks in _members(asset):
                target = folder / name
                target.parent.mkdir(exist_ok=True)
                with target.open("wb") as file:
                    for piece in _pieces(chunks):
                        file.write(piece)
                        meter.advance(len(piece))
    else:
        with new_file(path, size=size, overwrite=overwrite) as file:
            _write_packed(asset, file, meter)


def check_asset_folder(folder: Path) -> None:
    """Reject an existing folder with files that do not belong to an asset."""
    if not is_folder(folder) or not folder_is_taken(folder):
        return
    try:
        strays = [each.file for each in load(folder).warnings if each.code == "TRIASSET_FILE_UNDECLARED"]
    except MsbError:
        strays = [None]
    if strays:
        what = "other files" if strays[0] is None else shorten(strays[0], 60)
        text = f"it contains {what}, which would be lost; name another folder"
        raise UsageError("OUTPUT_EXISTS", text, file=folder)


def write_packed(asset: Asset, file: IO[bytes]) -> None:
    """Write a packed `.triasset` to an open file, so that the caller can create several files together."""
    _check_readable(asset, getattr(file, "name", None))
    _write_packed(asset, file, Meter("writing", 0, None))


def _check_readable(asset: Asset, path: object) -> None:
    """Raise an error if `load` would reject the manifest, or if the buffers do not fit the manifest."""
    raise_first_error(check_manifest(asset.manifest.to_dict()), path)
    size = len(asset.manifest.to_bytes())
    if size > MAX_BYTES:
        text = f"the manifest has {size} bytes; {MAX_BYTES} are allowed"
        raise AssetError("TRIASSET_MANIFEST", text, file=path)
    for name, spec in asset.manifest.buffers.items():
        array = asset.buffers.get(name)
        if array is None or (array.shape, array.dtype) != (spec.shape, DTYPES[spec.dtype]):
            actual = "missing" if array is None else f"{array.dtype} {list(array.shape)}"
            text = f"buffer {name} is {actual}; the manifest declares {spec.dtype} {list(spec.shape)}"
            raise AssetError("TRIASSET_BUFFER", text, file=path, pointer=f"/buffers/{name}/shape")


def _members(asset: Asset) -> Iterator[tuple[str, list[Any]]]:
    """Yield the name of each file, and its bytes in chunks.

    The manifest is the first file. The buffer files follow in the order of the manifest.
    """
    yield MANIFEST_NAME, [asset.manifest.to_bytes()]
    files: dict[str, list[Any]] = {}
    sizes: dict[str, int] = {}
    specs = sorted(asset.manifest.buffers.items(), key=lambda item: item[1].offset)
    for name, spec in specs:
        # Fill the gap before the aligned start of the buffer with zeros.
        gap = spec.offset - sizes.get(spec.file, 0)
        files.setdefault(spec.file, []).extend([bytes(gap), as_bytes(asset.buffers[name])])
        sizes[spec.file] = spec.offset + spec.byte_length
    for file in dict.fromkeys(spec.file for spec in asset.manifest.buffers.values()):
        yield file, files[file]


def _write_packed(asset: Asset, file: IO[bytes], meter: Meter) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, chunks in _members(asset):
            with stored_member(archive, file, name, sum(map(len, chunks))) as member:
                for piece in _pieces(chunks):
                    member.write(piece)
                    meter.advance(len(piece))


def stored_member(archive: zipfile.ZipFile, file: IO[bytes], name: str, size: int) -> IO[bytes]:
    """Open a member of a ZIP for writing. The member is stored without compression and without a date, and
    its data is aligned to 64 bytes."""
    info = zipfile.ZipInfo(name, _EPOCH)
    info.create_system = 3
    info.external_attr = 0o100644 << 16
    info.file_size = size
    large = size >= _ZIP64_FROM
    info.extra = _padding(file.tell() + _LOCAL_HEADER + len(name.encode()) + (_ZIP64_EXTRA if large else 0))
    return archive.open(info, "w", force_zip64=large)


def _pieces(chunks: list[Any]) -> Iterator[Any]:
    for chunk in chunks:
        for begin in range(0, len(chunk), CHUNK_BYTES):
            yield chunk[begin : begin + CHUNK_BYTES]


def _padding(start: int) -> bytes:
    """Return an extra field that moves the data from byte `start` to the next multiple of 64."""
    missing = -start % ALIGNMENT
    if missing == 0:
        return b""
    if missing < 4:  # The id and the length of the record take four bytes.
        missing += ALIGNMENT
    return struct.pack("<2H", _PADDING_ID, missing - 4) + bytes(missing - 4)
