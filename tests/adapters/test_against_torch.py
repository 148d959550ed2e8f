"""The same files read by torch and by us: the same types, values and bits."""

from __future__ import annotations

import random
import warnings
from pathlib import Path

import numpy as np
import pytest

from msb.adapters.checkpoint import BFloat16Array, read_checkpoint
from msb.errors import CheckpointError
from tests.adapters.describe import assert_same_arrays, describe

torch = pytest.importorskip("torch", reason="torch is not installed; golden files stand in for it")
from tests.adapters import torch_samples  # noqa: E402 it imports torch

pytestmark = [pytest.mark.torch, pytest.mark.slow, pytest.mark.oracle]


def both(path: Path, *, weights_only: bool = True) -> None:
    """Compare the two readers on one file."""
    allowed = [np._core.multiarray.scalar, np.dtype, *(type(np.dtype(code)) for code in "?bBhHiIlLefd")]
    with torch.serialization.safe_globals(allowed):
        theirs = torch.load(path, map_location="cpu", weights_only=weights_only)
    found, wanted = [], []
    ours = read_checkpoint(path)
    assert describe(ours, found) == describe(torch_samples.plain(theirs), wanted)
    assert_same_arrays(found, wanted)


@pytest.mark.parametrize("location", ["cpu", "cuda:0", "cuda:13", "mps"])
@pytest.mark.parametrize("variant", torch_samples.VARIANTS)
@pytest.mark.parametrize("sample", torch_samples.SAMPLES)
def test_same_as_torch(sample: str, variant: str, location: str, tmp_path: Path) -> None:
    path = tmp_path / "sample.pt"
    torch_samples.save(torch_samples.SAMPLES[sample](), path, variant, location)
    # torch's own careful reader knows the instructions of protocol 2 alone.
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


def test_strides_are_those_of_torch(tmp_path: Path) -> None:
    torch_samples.save(torch_samples.windows(), tmp_path / "a.pt", "zip2")
    ours = read_checkpoint(tmp_path / "a.pt")
    for name, tensor in torch_samples.windows().items():
        array = ours[name].bits if isinstance(ours[name], BFloat16Array) else ours[name]
        wanted = [s * array.itemsize for s, n in zip(tensor.stride(), tensor.shape, strict=True) if n > 1]
        assert [s for s, n in zip(array.strides, array.shape, strict=True) if n > 1] == wanted


def test_archives_without_checksums(tmp_path: Path) -> None:
    torch.serialization.set_crc32_options(False)
    try:
        torch_samples.save(torch_samples.windows(), tmp_path / "a.pt", "zip2")
    finally:
        torch.serialization.set_crc32_options(True)
    both(tmp_path / "a.pt")


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: torch.zeros(2, dtype=torch.complex64), "CHECKPOINT_FORM"),
        (lambda: torch.zeros(2, dtype=torch.uint16), "CHECKPOINT_FORM"),
        (lambda: torch.zeros(2, dtype=torch.float8_e4m3fn), "CHECKPOINT_FORM"),
        (lambda: torch.eye(2).to_sparse(), "CHECKPOINT_FORM"),
        (lambda: torch.zeros(2, device="meta"), "CHECKPOINT_FORM"),
        (lambda: torch.zeros(1).expand(5), "CHECKPOINT_FORM"),
        (lambda: torch.nn.Linear(1, 1), "CHECKPOINT_HOSTILE"),
        (lambda: torch.float32, "CHECKPOINT_HOSTILE"),
        (lambda: {(1, 2): 3}, "CHECKPOINT_FORM"),
        (lambda: np.zeros(2), "CHECKPOINT_HOSTILE"),
        (lambda: {1, 2}, "CHECKPOINT_HOSTILE"),
    ],
)
def test_what_torch_writes_and_we_do_not_read(make, code: str, tmp_path: Path) -> None:
    torch_samples.save(make(), tmp_path / "a.pt", "zip2")
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(tmp_path / "a.pt")
    assert caught.value.code == code


def test_a_script_module_is_refused(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.script(torch.nn.Linear(1, 1)), str(tmp_path / "a.pt"))
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(tmp_path / "a.pt")
    assert caught.value.code == "CHECKPOINT_NOT_RECOGNISED"
