"""Paths and file names as callers and other systems give them."""

import os
import re
import shlex
import unicodedata
from pathlib import Path

from msb.errors import InputError, UsageError, shorten

# The types that may be given as a path.
PATH_TYPES = (str, os.PathLike)


def given_path(path: str | os.PathLike[str]) -> Path:
    """Return `path`; an empty text, which `Path` takes for the current folder, is refused."""
    if not isinstance(path, PATH_TYPES):
        text = f"the path is of type {type(path).__name__}; it must be text or a pathlib.Path"
        raise UsageError("USAGE", text)
    if not os.fspath(path):
        raise InputError("FILE_NOT_FOUND", "the path is empty; the current folder is called .")
    return Path(path)


def real_place(path: Path) -> str:
    """Return `path` with its links resolved. A path with a NUL, which no file has, stays as it is."""
    return os.path.realpath(path) if "\0" not in str(path) else str(path)


def shell_word(text: str | os.PathLike[str]) -> str:
    """Return the path `text` as one word of a command that sh, cmd.exe and PowerShell all read alike.

    Double quotes are the only ones that all three know. What they interpret inside of these ($, %, backticks,
    quotes) stands in single quotes, as a POSIX shell and PowerShell have it; cmd.exe has no way to say that.
    A path that begins with a hyphen, which a command takes for an option, gets ``./`` before it.
    """
    word = os.fspath(text)
    if word.startswith("-"):
        word = f".{os.sep}{word}"
    if word and re.fullmatch(r"[\w@+=:,./\\~-]+" if os.name == "nt" else r"[\w@+=:,./-]+", word):
        return word
    return f'"{word}"' if word and not re.search(r'["$`%!\\]', word) else shlex.quote(word)


def normal_form(name: str) -> str:
    """Return a file name in Unicode's composed normal form (NFC).

    Archives made on macOS hold accents apart from their letters; names that look the same are then other
    names to most file systems. Two names mean one file if this makes them equal.
    """
    return name if name.isascii() else unicodedata.normalize("NFC", name)


class SpelledFiles:
    """Files below a folder, by names that may be spelled in another normal form than the files are.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._listed: dict[Path, dict[str, list[str]]] = {}

    def find(self, name: str) -> Path:
        """Return the path below the folder that `name`, with forward slashes, means; it need not exist."""
        place = self._root
        for part in name.split("/"):
            place /= part if part.isascii() else self._as_stored(place, part)
        return place

    def _as_stored(self, folder: Path, name: str) -> str:
        if folder not in self._listed:
            names = self._listed[folder] = {}
            try:
                stored = sorted(os.listdir(folder))  # noqa: PTH208 - names, no paths
            except (OSError, ValueError):
                stored = []
            for each in stored:
                names.setdefault(normal_form(each), []).append(each)
        alike = self._listed[folder].get(normal_form(name), [name])
        if len(alike) > 1:
            text = (
                f"{len(alike)} files in it are called {shorten(alike[0], 60)} in different Unicode normal "
                "forms; leave one of them"
            )
            raise InputError("FILE_UNREADABLE", text, file=folder)
        return alike[0]
