"""Refuse arguments of public functions that have a wrong type."""

from __future__ import annotations

from msb.errors import UsageError

AN_ASSET = "an Asset, as msb.open returns it"
A_CAMERA = "an msb.Camera"


def check_type(name: str, value: object, kind: type, wanted: str) -> None:
    """Refuse an argument that is not of type `kind`.

    Parameters
    ----------
    name : str
        The name of the argument.
    wanted : str
        What the argument must be, in words for the message.

    Raises
    ------
    UsageError
        `USAGE`.
    """
    if not isinstance(value, kind):
        raise UsageError("USAGE", f"{name} is of type {type(value).__name__}; it must be {wanted}")
