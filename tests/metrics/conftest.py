"""Golden data of the metrics, and the synthetic VGG16 as a file."""

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.metrics.vgg import LAYERS
from tests.conftest import ROOT

Test = TypeVar("Test", bound="Callable[..., None]")
GOLDEN = ROOT / "tests" / "golden" / "metrics"
DTU = GOLDEN / "dtu_synthetic"


def needs_torch(test: Test) -> Test:
    """Mark a test that imports torch, which takes seconds. Only `make test-all` installs torch.

    Such a test runs in a separate session, because torch has crashed together with libraries of other tests.
    """
    absent = not (find_spec("torch") and find_spec("lpips"))
    marked = pytest.mark.skipif(absent, reason="extra lpips (torch, lpips) is not installed")(test)
    return pytest.mark.torch(pytest.mark.slow(pytest.mark.oracle(marked)))


def golden(name: str) -> Any:
    return json.loads((GOLDEN / name).read_text())


def synthetic_vgg(seed: int = 1) -> dict[str, NDArray[np.float32]]:
    """Return an untrained VGG16 from a formula: uniform numbers, weights scaled by sqrt(6 / (9 inputs))."""
    weights: dict[str, NDArray[np.float32]] = {}
    for layer, (number, inputs, outputs) in enumerate(LAYERS):
        base = seed * 2**40 + layer * 2**32
        weight = _symmetric(base, outputs * inputs * 9) * np.sqrt(6 / (9 * inputs))
        weights[f"features.{number}.weight"] = weight.astype(np.float32).reshape(outputs, inputs, 3, 3)
        weights[f"features.{number}.bias"] = (_symmetric(base + 2**31, outputs) * 0.05).astype(np.float32)
    return weights


def _symmetric(base: int, count: int) -> NDArray[np.float64]:
    """Return `count` numbers in [-1, 1): the upper 53 bits of SplitMix64 for base, base + 1, ..."""
    z: Any = np.uint64(base) + np.arange(count, dtype=np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return 2 * ((z >> np.uint64(11)).astype(np.float64) / 2**53) - 1


@pytest.fixture(scope="session")
def vgg_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vgg") / "synthetic.npz"
    np.savez(path, **synthetic_vgg())
    return path
