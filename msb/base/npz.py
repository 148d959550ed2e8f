"""Write arrays as NumPy files: a .npy file, or a .npz archive of named arrays."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write `array` like `numpy.save`. If the disk is full, the error states this reason."""
    with path.open("wb") as file:
        stream: Any = SimpleNamespace(write=file.write)  # avoid ndarray.tofile
        np.lib.format.write_array(stream, array, allow_pickle=False)


def write_npz(file: IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `arrays` like `numpy.savez`. The file can be read with `numpy.load`.

    On a full disk, `numpy.savez` of NumPy 1.26 leaves its archive open, and Python later prints a traceback.
    """
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            # zipfile must know in advance whether a member can exceed 4 GiB.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
