"""Outputs that appear whole or not at all.

An output is written beside its place under a temporary name, then renamed. A device or a pipe is written
through, because nothing can take its place.
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
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    Missing parent folders are made. On any failure the temporary file is removed and `path` is as before, and
    folders that were made for it are gone if they are empty.
    A symbolic link at `path` is itself replaced, not what it points to; only one that leads to a device or
    pipe is followed (`is_stream`), and written through. `size` are the bytes that will be written, if known,
    for the error about a full disk. Without `overwrite` nothing is replaced that is there or comes meanwhile.
    """
    target = _target(path)
    if is_stream(target):
        with _translated(target, None), _written_through(target) as file:
            yield file
        return
    temporary = _beside(target)
    with _translated(target, size):
        try:
            _refuse_existing(target, overwrite)
            _make_parent(target)
            _refuse_folder(target)
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
            _remove_made(target)
            raise


@contextlib.contextmanager
def new_files(paths: Sequence[Path], *, overwrite: bool = True) -> Iterator[Sequence[BinaryIO]]:
    """Yield a binary file for each of `paths`; all take their places when the block ends, or none does.

    They belong together, the last one as that which names the others. One alone is as `new_file` has it; of
    several none can be a device or pipe.
    """
    if len(paths) == 1:
        with new_file(paths[0], overwrite=overwrite) as file:
            yield [file]
        return
    targets = [_target(path) for path in paths]
    moves = [(_beside(target), target, _beside(target)) for target in targets]
    with contextlib.ExitStack() as stack:
        for temporary, target, aside in moves:
            stack.enter_context(_translated(target, None))
            if is_stream(target):
                text = f"it is a device or pipe, which takes one file; {len(targets)} are to be written"
                raise OutputError("OUTPUT_UNWRITABLE", text, file=target)
            stack.push(partial(_after_failure, target))
            stack.callback(_remove, aside)
            stack.callback(_remove, temporary)
            _refuse_existing(target, overwrite)
            _make_parent(target)
            _refuse_folder(target)
        files = [stack.enter_context(temporary.open("xb")) for temporary, _, _ in moves]
        yield files
        for file in files:
            file.flush()
            os.fsync(file.fileno())
        moved = []
        try:
            for temporary, target, aside in moves:
                was_there = os.path.lexists(target)
                if was_there:
                    _refuse_existing(target, overwrite)
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
    """Let a block in which only temporary files are written say so, and where, if their disk is full."""
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        text = f"temporary files cannot be written: {os.strerror(error.errno)}; TMPDIR names another folder"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=tempfile.gettempdir()) from error


@contextlib.contextmanager
def new_folder(
    path: str | os.PathLike[str], *, size: int | None = None, overwrite: bool = True
) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path` when the block ends without an error.

    The old folder or file is moved aside, the new one moved in, the old one removed; `size` and `overwrite`
    are as for `new_file`, but that an empty folder, where it stays empty, is always replaced.
    """
    target = _target(path)
    temporary, aside = _beside(target), _beside(target)
    with _translated(target, size):
        try:
            _refuse_stream(target)
            _refuse_existing(target, overwrite or _is_empty(target))
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
            _remove_made(target)
            if isinstance(error, OutputError) and error.file is not None:
                error = _about_target(error, temporary, target)
            raise error
        finally:
            if os.path.lexists(target):
                _remove(aside)


def _about_target(error: OutputError, temporary: Path, target: Path) -> OutputError:
    """Return the error of a file in the temporary folder as one of the file it would have become."""
    file = Path(str(error.file))
    if not file.is_relative_to(temporary):
        return error
    return error.at(target / file.relative_to(temporary))


def check_place(path: str | os.PathLike[str], *, folder: bool = False) -> None:
    """Refuse a place where no file, or no folder, can be written, before hours are spent on what goes there.

    Its parent folders need not exist.
    """
    target = _target(path)
    if is_stream(target):
        if folder:
            _refuse_stream(target)
        if not os.access(target, os.W_OK):
            text = f"it cannot be written: {os.strerror(errno.EACCES)}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)
        return
    with _translated(target, None):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            target.lstat()  # which leaves: a name too long
        if not folder:
            _refuse_folder(target)
        above = _above(target)
        _check_folder(target, above)
        if not os.access(above, os.W_OK | os.X_OK):
            text = f"it cannot be written: {os.strerror(errno.EACCES)}: {above}"
            raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def folder_is_taken(path: str | os.PathLike[str]) -> bool:
    """Return whether there is anything at `path` that a new folder would replace; an empty folder is not."""
    return os.path.lexists(path) and not is_stream(path) and not _is_empty(Path(path))


def _refuse_folder(target: Path) -> None:
    if target.is_dir():
        raise OutputError("OUTPUT_UNWRITABLE", "it is a folder; a file is to be written", file=target)


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Return whether what is at `path` can only be written through, never be replaced.

    These are devices, pipes and sockets, also by way of a link, and files this process holds open by their
    descriptor: ``/dev/stdout``, ``/dev/fd/63``, ``/proc/self/fd/3``, whatever they lead to.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISDIR(mode) and (not stat.S_ISREG(mode) or _descriptor(path) is not None)


# What a write fails with where the place is at fault: no room, or no way to write there.
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT}
# What replaces a file that is there, for who calls a function; commands name their own option instead.
REPLACES = "overwrite=True replaces it"
_LEFTOVER = re.compile(r"\..{1,50}\.[0-9a-f]{12}\.part", re.DOTALL)


def is_leftover(name: str) -> bool:
    """Return whether a name is that of a temporary file or folder: a leftover, if no writer is at work."""
    return _LEFTOVER.fullmatch(name) is not None


def remove_leftovers(folder: str | os.PathLike[str]) -> None:
    """Remove what writers that were killed left below `folder`; nobody may be writing there."""
    for root, folders, files in os.walk(folder):
        for name in [name for name in (*folders, *files) if is_leftover(name)]:
            _remove(Path(root, name))
        folders[:] = [name for name in folders if not is_leftover(name)]


def _target(path: str | os.PathLike[str]) -> Path:
    """Return `path` if a file system could hold something of that name."""
    target = Path(path)
    if target.name in ("", ".."):
        raise OutputError("OUTPUT_UNWRITABLE", "it is a folder that stays; give a name in it", file=path)
    try:
        possible = b"\0" not in os.fsencode(target)
    except UnicodeEncodeError:  # half of a surrogate pair
        possible = False
    if not possible:
        raise OutputError("OUTPUT_UNWRITABLE", "this is no name a file or folder can have", file=path)
    return target


def _descriptor(path: str | os.PathLike[str]) -> int | None:
    """Return the number of the open file of this process that `path` is another name of."""
    place = Path(os.path.abspath(path))  # noqa: PTH100 - the name itself, not what a link there leads to
    if str(place.parent) == "/dev" and place.name in _STANDARD:
        return _STANDARD.index(place.name)
    opened = ("/dev/fd", f"/proc/{os.getpid()}/fd")
    return int(place.name) if place.name.isdecimal() and os.path.realpath(place.parent) in opened else None


@contextlib.contextmanager
def _written_through(target: Path) -> Iterator[BinaryIO]:
    """Yield a file, in which a writer may seek; when the block ends without an error it goes to `target`."""
    with tempfile.TemporaryFile() as file:
        yield cast("BinaryIO", file)
        file.seek(0)
        number = _descriptor(target)
        if number == 1:
            sys.stdout.flush()
        # A descriptor goes on where it is; opened by its name a regular file would be written from its start.
        flags = os.O_WRONLY | getattr(os, "O_BINARY", 0)
        number = os.open(target, flags) if number is None else os.dup(number)
        with os.fdopen(number, "wb") as stream:
            shutil.copyfileobj(file, stream)


def _refuse_stream(target: Path) -> None:
    if is_stream(target):
        text = "it is a device or pipe; a folder is to be written"
        raise OutputError("OUTPUT_UNWRITABLE", text, file=target)


def _refuse_existing(target: Path, overwrite: bool) -> None:
    if not overwrite and os.path.lexists(target):
        raise _exists(target)


def _exists(target: Path) -> UsageError:
    return UsageError("OUTPUT_EXISTS", f"it exists; {REPLACES}", file=target)


def _move_to_new(temporary: Path, target: Path) -> None:
    """Rename a file or folder to a name that nothing has; what came there meanwhile stays: an error."""
    try:
        if not temporary.is_dir():
            target.hardlink_to(temporary)
            temporary.unlink()
            return
    except FileExistsError as error:
        raise _exists(target) from error
    except OSError:  # the file system has no hard links
        pass
    is_empty = temporary.is_dir() and _is_empty(target)
    _refuse_existing(target, is_empty)
    if is_empty and target.is_symlink():
        target.unlink()
    elif is_empty and os.name == "nt":  # where a folder replaces nothing
        target.rmdir()
    try:
        temporary.rename(target)  # a folder replaces no file, and no folder that holds anything
    except OSError as error:
        if error.errno in {errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR}:
            raise _exists(target) from error
        raise


def _is_empty(target: Path) -> bool:
    """Return whether there is a folder that holds nothing."""
    try:
        return next(target.iterdir(), None) is None
    except OSError:
        return False


_STANDARD = ("stdin", "stdout", "stderr")


def _beside(target: Path) -> Path:
    # 50 characters take at most 200 bytes: with what is added, still a name that fits into 255.
    return target.with_name(f".{target.name[:50]}.{secrets.token_hex(6)}.part")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


# Folders that were made for outputs; several threads may write into one of them.
_MADE: set[Path] = set()


def _make_parent(target: Path) -> None:
    missing = [place for place in target.absolute().parents if not os.path.lexists(place)]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        _check_folder(target, _above(target))
        raise
    finally:
        _MADE.update(place for place in missing if place.is_dir())


def _remove_made(target: Path) -> None:
    """Remove the folders above an output that failed which were made for it, or for others, and are empty."""
    for place in target.absolute().parents:
        if place not in _MADE:
            return
        with contextlib.suppress(OSError):
            place.rmdir()


def _after_failure(target: Path, kind: object, *_: object) -> None:
    if kind is not None:
        _remove_made(target)


def _above(target: Path) -> Path:
    """Return the nearest thing above the target that exists."""
    return next((place for place in target.parents if os.path.lexists(place)), Path())


def _check_folder(target: Path, above: Path) -> None:
    """Refuse what lies above the target but is no folder; the system's own words would be "File exists"."""
    if not above.is_dir():
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {above} is no folder", file=target)


@contextlib.contextmanager
def _translated(target: Path, size: int | None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in _NO_SPACE:
            reason += _space(target, size)
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be written: {reason}", file=target) from error


def _space(target: Path, size: int | None) -> str:
    """Return how much there is, and is needed if that is known; to be asked once the temporary is removed."""
    try:
        free = shutil.disk_usage(_above(target.absolute())).free
    except OSError:
        return ""
    return f" ({free:,} bytes are free" + ("" if size is None else f", {size:,} are needed") + ")"
