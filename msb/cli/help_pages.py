"""How help pages are laid out: no word is broken at the end of a line."""

from __future__ import annotations

import re
from typing import Any

from typer.core import TyperCommand

_LIBRARY: Any = TyperCommand.context_class
_UNBROKEN = "\ue000"
"""It stands for a hyphen inside a word while lines are broken."""
_HYPHEN = re.compile(r"(?<=\S)-(?=\S)")


class _WholeWords(_LIBRARY.formatter_class):  # type: ignore[misc]
    def write_text(self, text: str) -> None:
        super().write_text(_HYPHEN.sub(_UNBROKEN, text))

    def write_dl(self, rows: Any, *args: Any, **options: Any) -> None:
        kept = [tuple(_HYPHEN.sub(_UNBROKEN, text) for text in row) for row in rows]
        super().write_dl(kept, *args, **options)

    def getvalue(self) -> str:
        return str(super().getvalue()).replace(_UNBROKEN, "-")


class Context(_LIBRARY):  # type: ignore[misc]
    """What the library makes of a command's words, its help among them."""

    formatter_class = _WholeWords
