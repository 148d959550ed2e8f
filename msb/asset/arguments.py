"""Arguments of public functions that are of another type than they must be."""

from __future__ import annotations

from msb.errors import UsageError

AN_ASSET = "an Asset, as msb.open returns it"
A_CAMERA = "an msb.Camera"


def check_type(name: str, value: object, kind: type, wanted: str) -> None:
    """Refuse an argument that is no `kind`.

    Parameters
    ----------
    name : str
        Of the argument.
    wanted : str
        What it must be, for the message.

    Raises
    ------
    UsageError
        `USAGE`.
    """
    if not isinstance(value, kind):
        raise UsageError("USAGE", f"{name} is of type {type(value).__name__}; it must be {wanted}")
