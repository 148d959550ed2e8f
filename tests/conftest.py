"""What all tests share: where data is, and small meshes whose counts follow from how they are made."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared"


def pytest_configure(config: pytest.Config) -> None:
    """Give PoCL a kernel cache of this session's own, child processes included, unless one is set.

    What a killed compiler leaves in a cache, or another version of the kernels, must not decide a test.
    """
    if "POCL_CACHE_DIR" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="msb-test-pocl-", ignore_cleanup_errors=True)
        os.environ["POCL_CACHE_DIR"] = folder.name
        config.add_cleanup(folder.cleanup)


@pytest.fixture(scope="session")
def demo_asset() -> Path:
    """Return the shipped MeshSplatting-like asset."""
    return ROOT / "data_stubs" / "splat_like.triasset"


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the folder of other people's data, or skip: it is never committed."""
    if not (SHARED / "golden").is_dir():
        pytest.skip(f"the shared data folder is absent ({SHARED.name} beside the repository)")
    return SHARED


TETRAHEDRON = (
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)
BOOK = (
    np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]], np.float32),
    np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
)
