"""Folders that a command writes whole, with a list of their files: only these are ever replaced."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from msb.base.atomic import check_place, new_folder
from msb.errors import UsageError, shorten

LIST = "msb-files.json"
"""The list of what was written into a folder, beside the files themselves."""
_SCHEMA = "msb.files/1"


def is_own_folder(folder: Path) -> bool:
    """Return whether an earlier run wrote `folder`, which then holds a list of its files."""
    return listed_files(folder) is not None


def check_own_folder(folder: Path) -> None:
    """Check that `own_folder` can write a folder, before hours are spent on what goes there.

    Raises
    ------
    UsageError
        OUTPUT_EXISTS: it is a file, or holds files and no list of an earlier run.
    OutputError
        OUTPUT_UNWRITABLE: nothing can be written there.
    """
    check_place(folder, folder=True)
    if os.path.lexists(folder) and not folder.is_dir():
        raise UsageError("OUTPUT_EXISTS", "it is a file; name a folder", file=folder)
    if folder.is_dir() and any(folder.iterdir()) and not is_own_folder(folder):
        text = f"it holds files, and no {LIST} of an earlier run; name another folder"
        raise UsageError("OUTPUT_EXISTS", text, file=folder)


@contextlib.contextmanager
def own_folder(path: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` when the block ends without an error.

    With `overwrite` the files that an earlier run wrote are replaced or removed, and all others stay. The
    list of the new files is written last.

    Raises
    ------
    UsageError
        OUTPUT_EXISTS: as of `check_own_folder`; without `overwrite`, it holds anything; or a file is to be
        written that is there, but not in the list.
    """
    target = Path(path)
    check_own_folder(target)
    with new_folder(target, overwrite=overwrite) as made:
        yield made
        files = sorted(each.relative_to(made).as_posix() for each in made.rglob("*") if not each.is_dir())
        _keep_others(target, made)
        text = json.dumps({"schema": _SCHEMA, "files": files}, indent=1) + "\n"
        (made / LIST).write_text(text, encoding="utf-8", errors="backslashreplace")


def _keep_others(old: Path, new: Path) -> None:
    """Link into the new folder what somebody else put into the old one."""
    own = {*(listed_files(old) or ()), LIST}
    for root, folders, files in os.walk(old):
        links = [name for name in folders if Path(root, name).is_symlink()]
        for source in (Path(root, name) for name in (*files, *links)):
            place = source.relative_to(old)
            if place.as_posix() in own:
                continue
            target = new / place
            if os.path.lexists(target):
                text = f"{shorten(place.as_posix(), 60)} is there, but no earlier run wrote it"
                raise UsageError("OUTPUT_EXISTS", f"{text}; move it or name another folder", file=old)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(source, target, follow_symlinks=False)
            except OSError:  # the file system has no hard links
                shutil.copy2(source, target, follow_symlinks=False)


def listed_files(folder: Path) -> frozenset[str] | None:
    """Return the files in the list of a folder, None without a list."""
    try:
        document = json.loads((folder / LIST).read_text(encoding="utf-8"))
        if document["schema"] == _SCHEMA:
            return frozenset(map(str, document["files"]))
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return None
