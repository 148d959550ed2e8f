"""Arrays in NumPy's files: one, or named ones in an archive."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write `array` as `numpy.save` does, whose error on a full disk does not say that the disk is full."""
    with path.open("wb") as file:
        stream: Any = SimpleNamespace(write=file.write)  # a true file would be written by ndarray.tofile
        np.lib.format.write_array(stream, array, allow_pickle=False)


def write_npz(file: IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write `arrays` as `numpy.savez` writes them; `numpy.load` reads them back.

    `numpy.savez` of NumPy 1.26 leaves its archive open where a disk is full, and Python complains of that
    later, with a traceback below our one line.
    """
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            # zipfile must know before the first byte whether a member may pass 4 GiB.
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
