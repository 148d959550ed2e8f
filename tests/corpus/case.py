"""What a bad asset is: a name that says what is wrong, and the code that says so."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from msb.asset import Asset
from msb.errors import Severity
from tests.corpus.good import Parts, mesh, parts

Writer = Callable[[Path], object]


@dataclass(frozen=True)
class Case:
    """One bad asset: what `load` raises or tolerates, or what `validate` finds.

    `write` writes it at the path it is given; what else it needs goes beside it. `found_by` is the first that
    reports the code; the later ones do too. "command" is `msb validate`, which also knows what makes a face
    degenerate. `also` are codes of further errors that `validate` reports, because one fault has several
    consequences. One that is `denied` is bad only for a user whose permissions are checked, so not for root.
    """

    name: str
    code: str
    write: Writer
    severity: Severity = "error"
    found_by: Literal["load", "validate", "command"] = "load"
    also: tuple[str, ...] = ()
    denied: bool = False


def packed(name: str, code: str, make: Callable[[], Parts], **more: Any) -> Case:
    """Return a case that is a single file of the parts that `make` returns."""
    return Case(name, f"TRIASSET_{code}", lambda path: make().write_packed(path), **more)


def changed(
    name: str, code: str, changes: dict[str, Any], make: Callable[[], Asset] = mesh, **more: Any
) -> Case:
    """Return a packed case whose manifest has other values at these JSON pointers, or lacks them (REMOVE)."""

    def change() -> Parts:
        good = parts(make())
        for pointer, value in changes.items():
            good.change(pointer, value)
        return good

    return packed(name, code, change, **more)
