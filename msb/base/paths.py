"""Paths from callers, and file names from other systems."""

import os
import re
import shlex
import unicodedata
from pathlib import Path

from msb.errors import InputError, UsageError, shorten

# Types that functions accept as a path.
PATH_TYPES = (str, os.PathLike)


def given_path(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a `Path`.

    An empty text is an error, because `Path` would treat it as the current folder.
    """
    if not isinstance(path, PATH_TYPES):
        text = f"the path is of type {type(path).__name__}; pass text or a pathlib.Path"
        raise UsageError("USAGE", text)
    if not os.fspath(path):
        raise InputError("FILE_NOT_FOUND", "the path is empty; use . for the current folder")
    return Path(path)


def real_place(path: Path) -> str:
    """Return `path` with all links resolved. A path with a NUL, which cannot exist, is returned unchanged."""
    return os.path.realpath(path) if "\0" not in str(path) else str(path)


def shell_word(text: str | os.PathLike[str]) -> str:
    """Return a path as one word of a command line, quoted for sh, PowerShell and cmd.exe.

    Double quotes work in all three shells, unless the path contains $, %, backticks or quotes. A path with
    these characters gets single quotes, which cmd.exe does not understand. A path that begins with a hyphen
    gets the prefix ``./``, so that programs do not read it as an option.
    """
    word = os.fspath(text)
    if word.startswith("-"):
        word = f".{os.sep}{word}"
    if word and re.fullmatch(r"[\w@+=:,./\\~-]+" if os.name == "nt" else r"[\w@+=:,./-]+", word):
        return word
    return f'"{word}"' if word and not re.search(r'["$`%!\\]', word) else shlex.quote(word)


def normal_form(name: str) -> str:
    """Return a file name in Unicode's composed normal form (NFC).

    Archives from macOS store letters and accents separately (NFD). A decomposed name looks the same, but
    other systems treat it as a different name. Therefore names are compared in NFC.
    """
    return name if name.isascii() else unicodedata.normalize("NFC", name)


class SpelledFiles:
    """Find files below a folder, independent of the Unicode normal form of their names.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._listed: dict[Path, dict[str, list[str]]] = {}

    def find(self, name: str) -> Path:
        """Return the path of `name`, which has forward slashes, below the folder. The path need not exist."""
        place = self._root
        for part in name.split("/"):
            place /= part if part.isascii() else self._as_stored(place, part)
        return place

    def _as_stored(self, folder: Path, name: str) -> str:
        if folder not in self._listed:
            names = self._listed[folder] = {}
            try:
                stored = sorted(os.listdir(folder))  # noqa: PTH208 - returns names, not paths
            except (OSError, ValueError):
                stored = []
            for entry in stored:
                names.setdefault(normal_form(entry), []).append(entry)
        alike = self._listed[folder].get(normal_form(name), [name])
        if len(alike) > 1:
            name = shorten(alike[0], 60)
            text = f"the folder contains {len(alike)} files named {name} in different Unicode forms; keep one"
            raise InputError("FILE_UNREADABLE", text, file=folder)
        return alike[0]
