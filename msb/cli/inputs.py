"""Find the inputs that the user typed: assets, mesh files, checkpoints, and folders of these."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.adapters.locate import bare_models, is_checkpoint, locate
from msb.asset import ASSET_SUFFIX, is_asset
from msb.base.files import open_error
from msb.cli.failures import report_error
from msb.cli.output import failure
from msb.errors import InputError, MsbError, UsageError
from msb.meshes import MESH_SUFFIXES

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.errors import Finding


def expand(path: Path) -> list[Path]:
    """Return the input itself, or for a folder the assets, checkpoints and mesh files below it, sorted.

    If nothing has the typed name, it is read as a pattern (``*``, ``?``, ``[...]``, ``**``), which some
    shells pass on unchanged; everything that matches it is taken as if it were typed.
    """
    try:
        is_folder = path.is_dir()
    except OSError as error:
        raise open_error(error, path) from error
    if is_folder and not is_asset(path) and not is_checkpoint(path):
        found = sorted(_below(path))
        if not found and bare_models(path):
            locate(path)  # which refuses several
            return [path]
        if not found:
            wanted = ", ".join((ASSET_SUFFIX, *MESH_SUFFIXES))
            text = f"the folder holds no checkpoint and none of {wanted}"
            raise InputError("FILE_NOT_RECOGNISED", text, file=path)
        return found
    if not os.path.lexists(path):
        if found := _matches(path):
            return found
        raise InputError("FILE_NOT_FOUND", "there is no such file or folder", file=path)
    return [path]


def _matches(pattern: Path) -> list[Path]:
    text = str(pattern)
    if not glob.has_magic(text):
        return []
    # Not Path.glob: that takes no absolute pattern.
    names = sorted(glob.glob(text, recursive=True))  # noqa: PTH207
    return [one for name in names for one in expand(Path(name))]


def _below(folder: Path) -> Iterator[Path]:
    for root, folders, files in os.walk(folder):
        here = Path(root)
        assets = [name for name in folders if _is_input(here / name)]
        folders[:] = [name for name in folders if name not in assets and not name.startswith(".")]
        yield from (here / name for name in assets)
        wanted = (ASSET_SUFFIX, *MESH_SUFFIXES)
        yield from (here / name for name in files if name.lower().endswith(wanted))


def _is_input(folder: Path) -> bool:
    try:
        return is_asset(folder) or is_checkpoint(folder)
    except InputError:
        return True  # that it cannot be read is said of it, not of all


def open_asset(path: Path, output: Output) -> Asset:
    """Return the asset that `msb.open` gives, and print its warnings."""
    from msb.api.opening import open

    asset = open(path)
    note_warnings(asset.warnings, path, output)
    return asset


def for_each(
    paths: Iterable[Path],
    schema: str,
    output: Output,
    work: Callable[[Path, bool], tuple[dict[str, Any], int]],
    single: Iterable[str] = (),
) -> tuple[int, list[dict[str, Any]]]:
    """Call `work` with each input; write the documents that it returns, return the highest status and them.

    `work` is told whether the input is alone. An input that fails is a line on standard error, and a document
    with its error beside those of others. `single` are the options that take one input.
    """
    status = 0
    inputs: list[Path] = []
    documents: list[dict[str, Any]] = []

    def fail(path: Path, error: MsbError) -> int:
        documents.append(failure(schema, path, error))
        return max(status, report_error(error))

    for path in paths:
        try:
            inputs += expand(path)
        except MsbError as error:
            status = fail(path, error)
    for option in single if len(inputs) > 1 else ():
        raise UsageError("USAGE", f"{option} takes one mesh; there are {len(inputs)}")
    for path in inputs:
        if status and output.fail_fast:
            break
        try:
            document, own = work(path, len(inputs) == 1)
        except MsbError as error:
            status = fail(path, error)
            continue
        documents.append(document)
        status = max(status, own)
    if len(documents) > 1 or (documents and "error" not in documents[0]):
        output.write_documents(documents)
    return status, documents


def note_warnings(found: Iterable[Finding], path: Path, output: Output) -> None:
    """Print what the reader of `path` warned of."""
    for warning in found:
        output.note(warning.to_line(path))
