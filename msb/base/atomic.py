"""Atomic writes: an output is either complete or does not exist.

An output is written to a temporary file in the same folder, which is then renamed. Devices and pipes cannot
be replaced, so they are written directly after the output is complete.
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

from msb.errors import OutputError, UsageError


@contextlib.contextmanager
def new_file(
    path: str | os.PathLike[str], *, size: int | None = None, overwrite: bool = True
) -> Iterator[BinaryIO]:
    """Yield a binary file that replaces `path` when the block ends without an error.

    Missing parent folders are created. After an error `path` is unchanged, and the temporary file and
    created folders are removed. If `path` is a symbolic link, the link is replaced and its target is kept.
    Links to a device or pipe are followed (`is_stream`).

    Parameters
    ----------
    path : path-like
    size : int, optional
        Number of bytes that will be written. The error about a full disk reports this number.
    overwrite : bool
        If false, an existing file is an error, even if it appears while the block runs.
    """
    target = _target(path)
    if is_stream(target):
        with _output_errors(target, None), _direct_writer(target) as file:
            yield file
        return
    temporary = _temporary_name(target)
    with _output_errors(target, size):
        try:
            _reject_existing(target, overwrite)
            _make_parent(target)
            _reject_folder(target)
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if overwrite:
                temporary.replace(target)
            else:
                _move_to_new(temporary, target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            _remove_created(target)
            raise


@contextlib.contextmanager
def new_files(paths: Sequence[Path], *, overwrite: bool = True) -> Iterator[Sequence[BinaryIO]]:
    """Yield a binary file for each of `paths`.

    When the block ends, either all files are replaced, or no file.

    The files are replaced in the given order. A file that refers to the other files should be the last path.
    For a single path, the function behaves like `new_file`. Among several paths, devices and pipes are
    errors.
    """
    if len(paths) == 1:
        with new_file(paths[0], overwrite=overwrite) as file:
            yield [file]
        return
    targets = [_target(path) for path in paths]
    moves = [(_temporary_name(target), target, _temporary_name(target)) for target in targets]
    with contextlib.ExitStack() as stack:
        for temporary, target, aside in moves:
            stack.enter_context(_output_errors(target, None))
            if is_stream(target):
                text = f"{len(targets)} files cannot be written to a device or pipe; name a regular file"
                raise OutputError("OUTPUT_UNWRITABLE", text, file=target)
            stack.push(partial(_after_failure, target))
            stack.callback(_remove, aside)
            stack.callback(_remove, temporary)
            _reject_existing(target, overwrite)
            _make_parent(target)
            _reject_folder(target)
        # Write all temporary files completely before changing the first existing file.
        files = [stack.enter_context(temporary.open("xb")) for temporary, _, _ in moves]
        yield files
        for file in files:
            file.flush()
            os.fsync(file.fileno())
        # Keep a copy of each replaced file, and restore all copies after an error.
        moved = []
        try:
            for temporary, target, aside in moves:
                was_there = os.path.lexists(target)
                if was_there:
                    _reject_existing(target, overwrite)
                    shutil.copy2(target, aside, follow_symlinks=False)
                moved.append((target, aside if was_there else None))
                temporary.replace(target)
        except BaseException:
            for target, old in moved:
                if old is None:
                    _remove(target)
                else:
                    old.replace(target)
            raise


@contextlib.contextmanager
def room_for_temporaries() -> Iterator[None]:
    """Convert errors about temporary files in the block to an error with the folder and a remedy."""
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        text = f"temporary files cannot be written: {os.strerror(error.errno)}; set TMPDIR to another folder"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=tempfile.gettempdir()) from error


@contextlib.contextmanager
def new_folder(
    path: str | os.PathLike[str], *, size: int | None = None, overwrite: bool = True
) -> Iterator[Path]:
    """Yield a new folder that replaces `path` when the block ends without an error.

    The old folder or file is renamed, the new folder gets its name, and the old folder is deleted. The
    arguments `size` and `overwrite` have the same meaning as in `new_file`. An empty folder is always
    replaced.
    """
    target = _target(path)
    temporary, aside = _temporary_name(target), _temporary_name(target)
    with _output_errors(target, size):
        try:
            _reject_stream(target)
            _reject_existing(target, overwrite or _is_empty(target))
            _make_parent(target)
            temporary.mkdir()
            yield temporary
            try:
                if not overwrite:
                    _move_to_new(temporary, target)
                else:
                    if os.path.lexists(target):
                        target.rename(aside)
                    temporary.rename(target)
            except BaseException:
                if os.path.lexists(aside) and not os.path.lexists(target):
                    aside.rename(target)
                raise
        except BaseException as error:
            shutil.rmtree(temporary, ignore_errors=True)
            _remove_created(target)
            if isinstance(error, OutputError) and error.file is not None:
                error = _about_target(error, temporary, target)
            raise error
        finally:
            if os.path.lexists(target):
                _remove(aside)


def _about_target(error: OutputError, temporary: Path, target: Path) -> OutputError:
    """Convert an error about a temporary file to an error about the corresponding file in `target`."""
    file = Path(str(error.file))
    if not file.is_relative_to(temporary):
        return error
    return error.at(target / file.relative_to(temporary))


def check_place(path: str | os.PathLike[str], *, folder: bool = False) -> None:
    """Check that a file, or a folder if `folder` is true, can be written at `path`.

    Call this check before a long computation. The parent folders need not exist.

    Raises
    ------
    OutputError
        OUTPUT_UNWRITABLE.
    """
    target = _target(path)
    if is_stream(target):
        if folder:
            _reject_stream(target)
        if not os.access(target, os.W_OK):
            text = f"the path cannot be written: {os.strerror(errno.EACCES)}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)
        return
    with _output_errors(target, None):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            target.lstat()  # raises an error if the name is too long
        if not folder:
            _reject_folder(target)
        above = _above(target)
        _check_folder(target, above)
        if not os.access(above, os.W_OK | os.X_OK):
            text = f"the path cannot be written: {os.strerror(errno.EACCES)}: {above}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def check_new(path: str | os.PathLike[str]) -> None:
    """Raise OUTPUT_EXISTS if a file or folder exists at `path`. Devices and pipes are accepted."""
    target = _target(path)
    if not is_stream(target):
        _reject_existing(target, overwrite=False)


def folder_is_taken(path: str | os.PathLike[str]) -> bool:
    """Return whether a file or a non-empty folder exists at `path`."""
    return os.path.lexists(path) and not is_stream(path) and not _is_empty(Path(path))


def _reject_folder(target: Path) -> None:
    if target.is_dir():
        raise OutputError("OUTPUT_UNWRITABLE", "the path is a folder; name a file", file=target)


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Return whether `path` must be written directly, because another file cannot replace it.

    The result is true for devices, pipes and sockets, and for links to such files. The result is also true
    for open files of this process, such as ``/dev/stdout``, ``/dev/fd/63`` and ``/proc/self/fd/3``.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISDIR(mode) and (not stat.S_ISREG(mode) or _descriptor(path) is not None)


# Error numbers of a failed disk. The program did not cause the failure.
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT}
# The remedy in errors about existing files. Commands print "--force" in place of this text.
REPLACES = "overwrite=True replaces it"
_LEFTOVER = re.compile(r"\..{1,50}\.[0-9a-f]{12}\.part", re.DOTALL)


def is_leftover(name: str) -> bool:
    """Return whether `name` has the form of the temporary names of this module."""
    return _LEFTOVER.fullmatch(name) is not None


def remove_leftovers(folder: str | os.PathLike[str]) -> None:
    """Delete temporary files that killed processes left below `folder`.

    No other process may write to the folder during the call.
    """
    for root, folders, files in os.walk(folder):
        for name in [name for name in (*folders, *files) if is_leftover(name)]:
            _remove(Path(root, name))
        folders[:] = [name for name in folders if not is_leftover(name)]


def _target(path: str | os.PathLike[str]) -> Path:
    """Return `path` if a file system accepts its name."""
    target = Path(path)
    if target.name in ("", ".."):
        raise OutputError(
            "OUTPUT_UNWRITABLE", "the folder cannot be replaced; name a file in this folder", file=path
        )
    try:
        possible = b"\0" not in os.fsencode(target)
    except UnicodeEncodeError:  # the name has half of a surrogate pair
        possible = False
    if not possible:
        raise OutputError("OUTPUT_UNWRITABLE", "the path is not a possible file name", file=path)
    return target


def _descriptor(path: str | os.PathLike[str]) -> int | None:
    """Return the file descriptor that `path` names, such as 63 for ``/dev/fd/63``, or None."""
    place = Path(os.path.abspath(path))  # noqa: PTH100 - resolve must not follow a link at `path`
    if str(place.parent) == "/dev" and place.name in _STANDARD:
        return _STANDARD.index(place.name)
    opened = ("/dev/fd", f"/proc/{os.getpid()}/fd")
    return int(place.name) if place.name.isdecimal() and os.path.realpath(place.parent) in opened else None


@contextlib.contextmanager
def _direct_writer(target: Path) -> Iterator[BinaryIO]:
    """Yield a temporary file that allows seeking.

    At the end of the block, the temporary file is copied to `target`.
    """
    with tempfile.TemporaryFile() as file:
        yield cast("BinaryIO", file)
        file.seek(0)
        number = _descriptor(target)
        if number == 1:
            sys.stdout.flush()
        # Write at the current position of the file descriptor. A file opened by name would be written from
        # byte 0.
        flags = os.O_WRONLY | getattr(os, "O_BINARY", 0)
        number = os.open(target, flags) if number is None else os.dup(number)
        with os.fdopen(number, "wb") as stream:
            shutil.copyfileobj(file, stream)


def _reject_stream(target: Path) -> None:
    if is_stream(target):
        text = "the path is a device or pipe; name a folder"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def _reject_existing(target: Path, overwrite: bool) -> None:
    if not overwrite and os.path.lexists(target):
        raise _exists(target)


def _exists(target: Path) -> UsageError:
    return UsageError("OUTPUT_EXISTS", f"the path exists; {REPLACES}", file=target)


def _move_to_new(temporary: Path, target: Path) -> None:
    """Rename a file or folder. Raise OUTPUT_EXISTS if another program has created the output meanwhile."""
    try:
        if not temporary.is_dir():
            target.hardlink_to(temporary)
            temporary.unlink()
            return
    except FileExistsError as error:
        raise _exists(target) from error
    except OSError:  # this file system has no hard links
        pass
    is_empty = temporary.is_dir() and _is_empty(target)
    _reject_existing(target, is_empty)
    if is_empty and target.is_symlink():
        target.unlink()
    elif is_empty and os.name == "nt":  # Windows cannot replace a folder by renaming
        target.rmdir()
    try:
        temporary.rename(target)  # this call fails if the target is a file or a non-empty folder
    except OSError as error:
        if error.errno in {errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR}:
            raise _exists(target) from error
        raise


def _is_empty(target: Path) -> bool:
    """Return whether `target` is an empty folder."""
    try:
        return next(target.iterdir(), None) is None
    except OSError:
        return False


_STANDARD = ("stdin", "stdout", "stderr")


def _temporary_name(target: Path) -> Path:
    # The first 50 characters of the name take at most 200 bytes, and file systems allow 255 bytes.
    return target.with_name(f".{target.name[:50]}.{secrets.token_hex(6)}.part")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


# Folders that were created for outputs. Several threads can create one folder at the same time.
_CREATED: set[Path] = set()


def _make_parent(target: Path) -> None:
    missing = [place for place in target.absolute().parents if not os.path.lexists(place)]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        _check_folder(target, _above(target))
        raise
    finally:
        _CREATED.update(place for place in missing if place.is_dir())


def _remove_created(target: Path) -> None:
    """Delete the empty parent folders of a failed output, if this module created them."""
    for place in target.absolute().parents:
        if place not in _CREATED:
            return
        with contextlib.suppress(OSError):
            place.rmdir()


def _after_failure(target: Path, kind: object, *_: object) -> None:
    if kind is not None:
        _remove_created(target)


def _above(target: Path) -> Path:
    """Return the nearest existing parent folder of the target."""
    return next((place for place in target.parents if os.path.lexists(place)), Path())


def _check_folder(target: Path, above: Path) -> None:
    """Reject an output path that lies below a file.

    The operating system reports only "File exists" in this case.
    """
    if not above.is_dir():
        raise OutputError(
            "OUTPUT_UNWRITABLE", f"the path cannot be written: {above} is not a folder", file=target
        )


@contextlib.contextmanager
def _output_errors(target: Path, size: int | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _NO_SPACE:
            reason += _space(target, size)
        raise OutputError(
            "OUTPUT_UNWRITABLE", f"the path cannot be written: {reason}", file=target
        ) from error


def _space(target: Path, size: int | None) -> str:
    """Return the free and the needed disk space as text. Delete the temporary file before the call."""
    try:
        free = shutil.disk_usage(_above(target.absolute())).free
    except OSError:
        return ""
    return f" ({free:,} bytes are free" + ("" if size is None else f", {size:,} are needed") + ")"
