"""Compare the reader of checkpoints with torch: types, values and bits."""

import random
from pathlib import Path

import numpy as np
import pytest

from msb.adapters.checkpoint import read_checkpoint
from tests.adapters.describe import assert_same_arrays, describe

torch = pytest.importorskip("torch", reason="torch is not installed; other tests use golden files")
from tests.adapters import torch_samples  # noqa: E402 - it imports torch

pytestmark = [pytest.mark.torch, pytest.mark.slow, pytest.mark.oracle]


def both(path: Path, *, weights_only: bool = True) -> None:
    """Compare the two readers on one file."""
    allowed = [np._core.multiarray.scalar, np.dtype, *(type(np.dtype(code)) for code in "?bBhHiIlLefd")]
    with torch.serialization.safe_globals(allowed):
        theirs = torch.load(path, map_location="cpu", weights_only=weights_only)
    actual, expected = [], []
    ours = read_checkpoint(path)
    assert describe(ours, actual) == describe(torch_samples.plain(theirs), expected)
    assert_same_arrays(actual, expected)


@pytest.mark.parametrize("location", ["cpu", "cuda:0", "cuda:13", "mps"])
@pytest.mark.parametrize("variant", torch_samples.VARIANTS)
@pytest.mark.parametrize("sample", torch_samples.SAMPLES)
def test_same_as_torch(sample: str, variant: str, location: str, tmp_path: Path) -> None:
    path = tmp_path / "sample.pt"
    torch_samples.save(torch_samples.SAMPLES[sample](), path, variant, location)
    # The safe reader of torch only supports protocol 2.
    both(path, weights_only=variant.endswith("2"))


@pytest.mark.parametrize("variant", ["zip2", "legacy2"])
def test_random_windows_same_as_torch(variant: str, tmp_path: Path) -> None:
    rng = random.Random(f"windows {variant}")
    tensors = []
    while len(tensors) < 400:
        dtype = rng.choice(torch_samples.DTYPES)
        base = torch_samples.numbers(rng.randrange(1, 60), dtype=dtype)
        axes = rng.randrange(5)
        size = [rng.choice((0, 1, 1, 2, 3, 4)) for _ in range(axes)]
        stride = [rng.choice((1, 1, 2, 3, 5, 9)) for _ in range(axes)]
        offset = rng.randrange(4)
        last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if last < len(base) and int(np.prod(size)) <= len(base):
            tensors.append(torch.as_strided(base, size, stride, offset))
    torch_samples.save(tensors, tmp_path / "windows.pt", variant)
    both(tmp_path / "windows.pt")


def test_archives_without_checksums(tmp_path: Path) -> None:
    torch.serialization.set_crc32_options(False)
    try:
        torch_samples.save(torch_samples.windows(), tmp_path / "a.pt", "zip2")
    finally:
        torch.serialization.set_crc32_options(True)
    both(tmp_path / "a.pt")
