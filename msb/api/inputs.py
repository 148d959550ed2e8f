"""Expand the inputs of a command line: assets, mesh files, checkpoints, folders of such files, and
patterns."""

import glob
import os
from collections.abc import Iterator
from pathlib import Path

from msb.adapters.locate import bare_models, is_checkpoint, locate
from msb.asset import ASSET_SUFFIX, is_asset
from msb.base.files import open_error
from msb.errors import InputError
from msb.meshes import MESH_SUFFIXES


def expand(path: Path) -> list[Path]:
    """Return the inputs of a path or pattern without repeats. Folders in `matches` are expanded."""
    return list(dict.fromkeys(each for match in matches(path) for each in inputs_at(match)))


def matches(path: Path) -> list[Path]:
    """Return `path` if it exists, otherwise the sorted paths that match `path` as a pattern.

    Some shells do not expand patterns (``*``, ``?``, ``[...]``, ``**``). Files inside a matching asset or
    checkpoint are omitted.
    """
    if _is_folder(path) or os.path.lexists(path):
        return [path]
    text = str(path)
    # Path.glob does not accept absolute patterns.
    names = sorted(glob.glob(text, recursive=True)) if glob.has_magic(text) else []  # noqa: PTH207
    if not names:
        raise InputError("FILE_NOT_FOUND", "it does not exist", file=path)
    paths = [Path(name) for name in names]
    # A pattern such as ** also matches the files inside an asset or checkpoint.
    folders = {match for match in paths if _is_folder(match) and is_input(match)}
    return [match for match in paths if folders.isdisjoint(match.parents)]


def inputs_at(path: Path) -> list[Path]:
    """If the path is not a folder, return the path itself. For a folder, return the assets, checkpoints and
    mesh files inside, in sorted order."""
    if not _is_folder(path) or is_asset(path) or is_checkpoint(path):
        return [path]
    inputs = sorted(_find_below(path))
    # If no folder name fits a method, the folder can still contain a single model file.
    if not inputs and bare_models(path):
        locate(path)  # Raises an error if the folder contains several models.
        return [path]
    if not inputs:
        wanted = ", ".join((ASSET_SUFFIX, *MESH_SUFFIXES))
        text = f"the folder contains no checkpoint and no file with a suffix of {wanted}"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path)
    return inputs


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise open_error(error, path) from error


def _find_below(folder: Path) -> Iterator[Path]:
    """Yield the inputs in a folder and its subfolders, except hidden folders."""
    for root, folders, files in os.walk(folder):
        here = Path(root)
        # A folder that is an asset or a checkpoint counts as one input. The content of this folder is not
        # searched.
        assets = [name for name in folders if is_input(here / name)]
        folders[:] = [name for name in folders if name not in assets and not name.startswith(".")]
        yield from (here / name for name in assets)
        wanted = (ASSET_SUFFIX, *MESH_SUFFIXES)
        yield from (here / name for name in files if name.lower().endswith(wanted))


def is_input(folder: Path) -> bool:
    """Return whether a folder is a single input: an asset or a checkpoint."""
    try:
        return is_asset(folder) or is_checkpoint(folder)
    except InputError:
        return True  # The error is reported when this input is opened.
