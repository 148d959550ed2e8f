"""Write a whole folder of results.

The folder contains a list of the written files. A later run replaces the listed files and keeps all other
files.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from msb.base.atomic import check_place, new_folder
from msb.errors import UsageError, shorten

# Name of the list file in the folder.
LIST = "msb-files.json"
_SCHEMA = "msb.files/1"


def check_own_folder(folder: Path) -> None:
    """Check that `own_folder` can write a folder. Call this check before a long computation.

    Raises
    ------
    UsageError
        OUTPUT_EXISTS: the path is a file, or a folder with files but without the list of an earlier run.
    OutputError
        OUTPUT_UNWRITABLE: the folder cannot be written.
    """
    check_place(folder, folder=True)
    if os.path.lexists(folder) and not folder.is_dir():
        raise UsageError("OUTPUT_EXISTS", "the path is a file; name a folder", file=folder)
    if folder.is_dir() and any(folder.iterdir()) and listed_files(folder) is None:
        text = f"the folder contains files, but not the {LIST} of an earlier run; name another folder"
        raise UsageError("OUTPUT_EXISTS", text, file=folder)


@contextlib.contextmanager
def own_folder(path: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[Path]:
    """Yield a temporary folder that replaces `path` when the block ends without an error.

    With `overwrite`, the files of an earlier run are replaced or removed, and all other files stay. After
    an error, the old folder is unchanged. If `path` is a link to a folder, that folder is replaced and the
    link stays.

    Raises
    ------
    UsageError
        OUTPUT_EXISTS: as in `check_own_folder`; or the folder is not empty and `overwrite` is false; or a
        new file would replace a file that is not in the list.
    """
    target = Path(path)
    if target.is_symlink() and target.is_dir():
        target = Path(os.path.realpath(target))
    check_own_folder(target)
    with new_folder(target, overwrite=overwrite) as folder:
        yield folder
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
        _keep_others(target, folder)
        text = json.dumps({"schema": _SCHEMA, "files": files}, indent=1) + "\n"
        (folder / LIST).write_text(text, encoding="utf-8", errors="backslashreplace")


def _keep_others(old: Path, new: Path) -> None:
    """Copy files of the old folder to the new folder, except the files in the old folder's list.

    The copies are hard links if possible.
    """
    listed = {*(listed_files(old) or ()), LIST}
    for root, folders, files in os.walk(old):
        if not folders and not files:
            (new / Path(root).relative_to(old)).mkdir(parents=True, exist_ok=True)
        links = [name for name in folders if Path(root, name).is_symlink()]
        for source in (Path(root, name) for name in (*files, *links)):
            place = source.relative_to(old)
            if place.as_posix() in listed:
                continue
            target = new / place
            # Do not replace a user's file that has the name of a new file.
            if os.path.lexists(target):
                text = f"{shorten(place.as_posix(), 60)} exists and is not in the list of an earlier run"
                raise UsageError("OUTPUT_EXISTS", f"{text}; move it or name another folder", file=old)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(source, target, follow_symlinks=False)
            except OSError:  # this file system has no hard links
                shutil.copy2(source, target, follow_symlinks=False)


def listed_files(folder: Path) -> frozenset[str] | None:
    """Return the paths in the list of a folder, relative to the folder, or None if the folder has no valid
    list."""
    try:
        document = json.loads((folder / LIST).read_text(encoding="utf-8"))
        if document["schema"] == _SCHEMA:
            return frozenset(map(str, document["files"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    return None
