"""The golden data of the metrics, and the synthetic VGG16 as a file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.metrics.synthetic_vgg import synthetic_vgg

if TYPE_CHECKING:
    from pathlib import Path

GOLDEN = ROOT / "tests" / "golden" / "metrics"
DTU = GOLDEN / "dtu_synthetic"


def golden(name: str) -> Any:
    return json.loads((GOLDEN / name).read_text())


@pytest.fixture(scope="session")
def vgg_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vgg") / "synthetic.npz"
    np.savez(path, **synthetic_vgg())
    return path
