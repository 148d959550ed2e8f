"""Real files, without torch: those torch wrote for us, and the four methods' golden checkpoints."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fuzz import readers
from msb.adapters.checkpoint import read_checkpoint
from msb.errors import CheckpointError
from tests.adapters.assemble import GOOD, archive, legacy
from tests.adapters.describe import assert_same_arrays, describe

GOLDEN = Path(__file__).parent.parent / "golden" / "checkpoints"
FILES = sorted(path.name for path in GOLDEN.glob("*.pt"))

# --- files of torch 2.13 (tests/adapters/torch_samples.py)


@pytest.mark.parametrize("file", FILES)
def test_a_file_of_torch_holds_what_torch_says(file: str) -> None:
    sample = file.rpartition("_")[0]
    expected = json.loads((GOLDEN / "expected.json").read_text())[sample]
    found: list[np.ndarray] = []
    assert describe(read_checkpoint(GOLDEN / file), found) == expected
    with np.load(GOLDEN / "expected.npz") as kept:
        assert_same_arrays(found, [kept[f"{sample}/{i}"] for i in range(len(found))])


# --- the methods' files, whose tensors test_golden_exports.py compares


@pytest.mark.parametrize(
    ("pattern", "least"),
    [
        ("mesh_splatting/*/checkpoint*/**/point_cloud_state_dict.pt", 4),
        ("triangle_splatting/*/checkpoint/**/*.pt", 8),
        ("two_dts/*/checkpoint/ckpt/*.ckpt", 3),
        ("diffsoup/*/checkpoint/final_params.pt", 3),
    ],
)
def test_files_of_the_methods_are_read_whole(shared: Path, pattern: str, least: int) -> None:
    paths = sorted((shared / "golden").glob(pattern))
    if not paths:
        pytest.skip(f"the shared data folder has no {pattern}")
    assert len(paths) >= least
    for path in paths:
        readers.checkpoint(path)


@pytest.mark.parametrize("make", [archive, legacy])
def test_what_the_bad_checkpoints_are_made_from_is_good(make: Callable[[], bytes], tmp_path: Path) -> None:
    (tmp_path / "good.pt").write_bytes(make())
    value = read_checkpoint(tmp_path / "good.pt")
    assert list(value) == ["w"]
    np.testing.assert_array_equal(value["w"], np.arange(1, 7, dtype=np.float32).reshape(2, 3))


def test_the_byte_at_fault_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(archive(GOOD.replace(b"OrderedDict", b"OrderedDict_")))
    with pytest.raises(CheckpointError, match="CHECKPOINT_HOSTILE") as caught:
        read_checkpoint(tmp_path / "a.pt")
    member, _, at = (caught.value.pointer or "").split()
    assert member == "data.pkl"
    assert GOOD[int(at) :].startswith(b"ccollections\n")
