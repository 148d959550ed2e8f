"""The state of a training: one .npz with arrays and JSON, without executable content."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.atomic import new_file
from msb.base.npz import write_npz
from msb.errors import UsageError

FILE = "training.npz"
_ABOUT = "about"


def write_state(path: Path, arrays: dict[str, NDArray[Any]], about: dict[str, Any]) -> None:
    """Write arrays and JSON data, replacing an earlier state."""
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    with new_file(path) as file:
        write_npz(file, {**arrays, _ABOUT: text})


def read_state(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read a file of `write_state`."""
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            # Arrays are not compressed. Arrays that are larger than the file were not written by this module.
            if sum(member.file_size for member in file.zip.infolist()) > path.stat().st_size:
                raise ValueError("its arrays are larger than the file")
            arrays = {name: file[name] for name in file.files}
        about = json.loads(bytes(arrays.pop(_ABOUT)))
        if not isinstance(about, dict) or not all(isinstance(one, np.ndarray) for one in arrays.values()):
            raise TypeError("it has other contents")
    except Exception as error:  # zipfile and NumPy raise many kinds of exceptions
        text = f"{path}: it is not the state of a training ({type(error).__name__})"
        raise UsageError("USAGE", text) from None
    return arrays, about
