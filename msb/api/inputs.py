"""The inputs that a user names: assets, mesh files, checkpoints, folders of these, and patterns."""

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
    """Return all inputs that a typed path stands for: by `matches` and `inputs_at`, each once."""
    return list(dict.fromkeys(each for match in matches(path) for each in inputs_at(match)))


def matches(path: Path) -> list[Path]:
    """Return the typed path itself, or everything that matches it as a pattern, sorted.

    If nothing has the typed name, it is read as a pattern (``*``, ``?``, ``[...]``, ``**``), which some
    shells pass on unchanged; everything that matches it is taken as if it were typed, but for the parts of an
    asset or checkpoint that matches.
    """
    if _is_folder(path) or os.path.lexists(path):
        return [path]
    text = str(path)
    # Not Path.glob: that takes no absolute pattern.
    names = sorted(glob.glob(text, recursive=True)) if glob.has_magic(text) else []  # noqa: PTH207
    if not names:
        raise InputError("FILE_NOT_FOUND", "there is no such file or folder", file=path)
    found = [Path(name) for name in names]
    # What such a pattern as ** matches in an asset or checkpoint is that one again.
    whole = {each for each in found if _is_folder(each) and is_input(each)}
    return [each for each in found if whole.isdisjoint(each.parents)]


def inputs_at(path: Path) -> list[Path]:
    """Return the input itself, or for a folder the assets, checkpoints and mesh files below it, sorted."""
    if not _is_folder(path) or is_asset(path) or is_checkpoint(path):
        return [path]
    inputs = sorted(_below(path))
    if not inputs and bare_models(path):
        locate(path)  # which refuses several
        return [path]
    if not inputs:
        wanted = ", ".join((ASSET_SUFFIX, *MESH_SUFFIXES))
        text = f"the folder holds no checkpoint and none of {wanted}"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path)
    return inputs


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise open_error(error, path) from error


def _below(folder: Path) -> Iterator[Path]:
    for root, folders, files in os.walk(folder):
        here = Path(root)
        assets = [name for name in folders if is_input(here / name)]
        folders[:] = [name for name in folders if name not in assets and not name.startswith(".")]
        yield from (here / name for name in assets)
        wanted = (ASSET_SUFFIX, *MESH_SUFFIXES)
        yield from (here / name for name in files if name.lower().endswith(wanted))


def is_input(folder: Path) -> bool:
    """Return whether a folder is one input: an asset or a checkpoint."""
    try:
        return is_asset(folder) or is_checkpoint(folder)
    except InputError:
        return True  # that it cannot be read is said of it, not of all
