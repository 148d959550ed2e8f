"""Every prefix and thousands of seeded mutations of small real files: our error, or a sound value."""

from __future__ import annotations

import os
import random
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.adapters.checkpoint import BFloat16Array, read_checkpoint
from msb.errors import CheckpointError
from tests.adapters.assemble import archive
from tests.asset.test_mutations import mutate_bytes, put

GOLDEN = Path(__file__).parent.parent / "golden" / "checkpoints"
SMALL = ["dtypes_zip2.pt", "optimizer_zip4.pt", "windows_legacy2.pt", "numpy_scalars_legacy2.pt"]
TIMES = int(os.environ.get("MSB_MUTATIONS", "1"))
FILE_MUTATIONS = 1500 * TIMES  # of each of four files
PICKLE_MUTATIONS = 2500 * TIMES  # of each of three pickles, in an archive whose checksums are right
PICKLES = ["optimizer_zip2.pt", "parameters_zip2.pt", "numpy_scalars_zip2.pt"]


def walk(value: Any, size: int) -> None:
    """Touch every value, recursively and without remembering anything, as a careless user would."""
    if isinstance(value, BFloat16Array):
        value = value.bits
    if isinstance(value, np.ndarray):
        assert not value.flags.writeable
        assert value.nbytes <= size
        value.tobytes()
    elif isinstance(value, dict):
        for key, item in value.items():
            assert type(key) in (str, int)
            walk(item, size)
    elif isinstance(value, list | tuple):
        for item in value:
            walk(item, size)
    else:
        assert value is None or type(value) in (str, int, float, bool, bytes)


def outcome(path: Path, data: bytes) -> str:
    """Return the code that reading `data` gives, or "" for a sound value."""
    put(path, data)
    try:
        value = read_checkpoint(path)
    except CheckpointError as error:
        refused = error
    else:
        walk(value, len(data))
        return ""
    assert str(refused).isprintable()
    assert len(str(refused)) < 600
    return refused.code


@pytest.mark.parametrize("file", SMALL)
def test_every_prefix_is_refused(file: str, tmp_path: Path) -> None:
    data = (GOLDEN / file).read_bytes()
    codes = {outcome(tmp_path / "a.pt", data[:length]) for length in range(len(data))}
    assert "" not in codes
    if "zip" in file:
        assert codes == {"CHECKPOINT_EMPTY", "CHECKPOINT_NOT_RECOGNISED", "CHECKPOINT_ZIP_TRUNCATED"}


@pytest.mark.parametrize("file", SMALL)
def test_mutated_files_are_refused_or_sound(file: str, tmp_path: Path) -> None:
    rng = random.Random(f"file {file}")
    data = (GOLDEN / file).read_bytes()
    codes = [outcome(tmp_path / "a.pt", mutate_bytes(data, rng)) for _ in range(FILE_MUTATIONS)]
    assert 0.3 < sum(map(bool, codes)) / len(codes) < 1
    assert len(set(codes)) > 8


@pytest.mark.parametrize("file", PICKLES)
def test_mutated_pickles_are_refused_or_sound(file: str, tmp_path: Path) -> None:
    rng = random.Random(f"pickle {file}")
    pickle, storages = parts(GOLDEN / file)
    codes = []
    for _ in range(PICKLE_MUTATIONS):
        mutant = archive(mutate_bytes(pickle, rng), storages)
        codes.append(outcome(tmp_path / "a.pt", mutant))
    assert outcome(tmp_path / "a.pt", archive(pickle, storages)) == ""
    assert 0.5 < sum(map(bool, codes)) / len(codes) < 1
    assert len(set(codes)) > 15


def parts(path: Path) -> tuple[bytes, dict[str, bytes]]:
    """Return data.pkl and the storages of an archive."""
    with zipfile.ZipFile(path) as file:
        members = {name.partition("/")[2]: file.read(name) for name in file.namelist()}
    storages = {name[5:]: data for name, data in members.items() if name.startswith("data/")}
    return members["data.pkl"], storages
