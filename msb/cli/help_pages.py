"""How help pages are laid out: plain names, and no word broken at the end of a line."""

from __future__ import annotations

import re
from typing import Any

_TYPES = (("<int range>", "N"), ("<int>", "N"), ("<float range>", "X"), ("<float>", "X"))
"""What the library calls a number without a name -> what a user reads."""
_UNBROKEN = "\ue000"
"""It stands for a hyphen inside a word while lines are broken."""
_HYPHEN = re.compile(r"(?<=\S)-(?=\S)")


def plain_usage(piece: str) -> str:
    """Return a word of the usage; the library puts braces around an argument that is required."""
    return re.sub(r"\{([^|{}]*)\}(\.\.\.)?$", r"\1", piece)


def plain_record(param: Any, record: tuple[str, str]) -> tuple[str, str]:
    """Return a row of a help page: the left side of an argument is its name, a number is N or X."""
    typed, meaning = record
    if param.param_type_name == "argument":
        typed = typed if "|" in typed else typed.split(" ")[0]
        meaning = meaning.removesuffix("[required]").rstrip()
    for library, ours in _TYPES:
        typed = typed.replace(library, ours)
    meaning = re.sub(r"([\d.]+)<=x<=([\d.]+)", r"\1 to \2", meaning)
    meaning = re.sub(r"x>=([\d.]+)", r"\1 or more", meaning)
    return typed, meaning.removesuffix("[default: 0]").rstrip() if getattr(param, "count", False) else meaning


def whole_words(formatter_class: type) -> type:
    """Return a class of formatters that break lines between words only, not at a hyphen in one."""

    class WholeWords(formatter_class):  # type: ignore[misc]
        def write_text(self, text: str) -> None:
            super().write_text(_HYPHEN.sub(_UNBROKEN, text))

        def write_dl(self, rows: Any, *args: Any, **options: Any) -> None:
            kept = [tuple(_HYPHEN.sub(_UNBROKEN, text) for text in row) for row in rows]
            super().write_dl(kept, *args, **options)

        def getvalue(self) -> str:
            return str(super().getvalue()).replace(_UNBROKEN, "-")

    return WholeWords
