"""The golden data of the metrics, and the synthetic VGG16 as a file."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.metrics.synthetic_vgg import synthetic_vgg

Test = TypeVar("Test", bound="Callable[..., None]")
GOLDEN = ROOT / "tests" / "golden" / "metrics"
DTU = GOLDEN / "dtu_synthetic"


def needs_torch(test: Test) -> Test:
    """Mark a test that imports torch: seconds, and gigabytes that only `make test-all` installs.

    It runs in a session of its own: beside what other tests have loaded torch has crashed.
    """
    absent = not (find_spec("torch") and find_spec("lpips"))
    marked = pytest.mark.skipif(absent, reason="extra lpips (torch, lpips) is not installed")(test)
    return pytest.mark.torch(pytest.mark.slow(pytest.mark.oracle(marked)))


def golden(name: str) -> Any:
    return json.loads((GOLDEN / name).read_text())


@pytest.fixture(scope="session")
def vgg_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vgg") / "synthetic.npz"
    np.savez(path, **synthetic_vgg())
    return path
