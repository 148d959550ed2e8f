"""The state of a training: one .npz of arrays and JSON, which nothing in it can execute."""

from __future__ import annotations

import json
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.atomic import new_file
from msb.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

FILE = "training.npz"
_ABOUT = "about"


def write_state(path: Path, arrays: dict[str, NDArray[Any]], about: dict[str, Any]) -> None:
    """Write arrays and what JSON can hold, in the place of what is there."""
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    with new_file(path) as file:
        np.savez(file, **arrays, **{_ABOUT: text})


def read_state(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return what `write_state` wrote.

    Raises
    ------
    UsageError
        USAGE: there is no such file, or it is none of ours.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about: dict[str, Any] = json.loads(bytes(arrays.pop(_ABOUT)))
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        text = f"{path} is no state of a training that can be resumed ({type(error).__name__})"
        raise UsageError("USAGE", text) from None
    return arrays, about
