"""What a bad asset is: a name that says what is wrong, and the code that says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msb.errors import Severity
from tests.corpus.good import Parts

Writer = Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """One bad asset.

    Attributes
    ----------
    name : str
        Of the file; it says what is wrong.
    code : str
        What `load` raises or tolerates, or what `validate` finds.
    write : callable
        Writes the asset at the path it is given; what else it needs goes beside it.
    severity : str
        Of the finding; an error at `load` is raised.
    found_by : {"load", "validate", "command"}
        The first that reports it; the later ones do too. "command" is `msb validate`, which also knows
        what makes a face degenerate.
    also : tuple of str
        Codes of further errors `validate` reports, because one fault has several consequences.
    denied : bool
        The asset is bad only for a user whose permissions are checked, so not for root.
    """

    name: str
    code: str
    write: Writer
    severity: Severity = "error"
    found_by: Literal["load", "validate", "command"] = "load"
    also: tuple[str, ...] = ()
    denied: bool = False


def packed(make: Callable[[], Parts]) -> Writer:
    """Return a writer of the parts that `make` returns, as a single file."""
    return lambda path: make().write_packed(path)


def folder(make: Callable[[], Parts]) -> Writer:
    """Return a writer of the parts that `make` returns, as a folder."""
    return lambda path: make().write_folder(path)
