"""Definition of a bad asset: its name, the expected error code, and a function that writes it."""

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
    """A bad asset.

    Attributes
    ----------
    name : str
    code : str
        The expected error code.
    write : callable
        Writes the asset to a path, and further files beside it.
    severity : str
        "error" if `load` raises, "warning" or "info" if it does not.
    found_by : "load", "validate" or "command"
        The first check that reports the code. The checks after it report the code as well. "command" is
        `msb validate`, which also finds degenerate faces.
    also : tuple of str
        Codes of further errors that `validate` reports as consequences of the same fault.
    denied : bool
        Whether the asset is good for root, because the system does not check root's permissions.
    """

    name: str
    code: str
    write: Writer
    severity: Severity = "error"
    found_by: Literal["load", "validate", "command"] = "load"
    also: tuple[str, ...] = ()
    denied: bool = False


def packed_case(name: str, code: str, make: Callable[[], Parts], **more: Any) -> Case:
    """Return a case that is a single file, packed from the parts returned by `make`."""
    return Case(name, f"TRIASSET_{code}", lambda path: make().write_packed(path), **more)


def manifest_case(
    name: str, code: str, changes: dict[str, Any], make: Callable[[], Asset] = mesh, **more: Any
) -> Case:
    """Return a packed case with `changes` of its manifest.

    They map JSON pointers to new values or to REMOVE.
    """

    def change() -> Parts:
        good = parts(make())
        for pointer, value in changes.items():
            good.change(pointer, value)
        return good

    return packed_case(name, code, change, **more)
