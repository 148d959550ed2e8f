"""Check the types and values of arguments of public functions."""

from numbers import Integral, Real

import numpy as np

from msb.errors import UsageError, shorten

AN_ASSET = "an Asset, as msb.open returns it"
A_CAMERA = "an msb.Camera"


def check_type(name: str, value: object, kind: type, wanted: str) -> None:
    """Check that an argument is of type `kind`. The text `wanted` describes the type in the message."""
    if not isinstance(value, kind):
        raise UsageError("USAGE", f"{name} is of type {type(value).__name__}; it must be {wanted}")


def checked_number(name: str, value: object, *, whole: bool = False) -> float:
    """Return a number of Python or NumPy as a Python number."""
    kind = Integral if whole else Real
    if isinstance(value, kind) and not isinstance(value, bool | np.bool_):
        number = int(value) if isinstance(value, Integral) else float(value)
        if 0 <= number < np.inf:
            return number
    wanted = "a whole number, 0 or more" if whole else "0 or more"
    raise UsageError("USAGE", f"{name} is {shorten(repr(value), 40)}; it must be {wanted}")
