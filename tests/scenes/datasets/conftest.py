"""Copies of the stub scenes that tests may modify."""

import shutil
from pathlib import Path
from typing import Protocol

import pytest

from tests.conftest import ROOT

STUBS = ROOT / "tests" / "tiny" / "scenes"
SCENES = ("mipnerf360/pebble", "tanksandtemples/pebble", "nerf_synthetic/pebble", "dtu/scan1")


class Copy(Protocol):
    """Copy a stub scene: ``copy("dtu/scan1")``, to another path if one is given."""

    def __call__(self, scene: str, to: str | None = None) -> Path: ...


def text_model(root: Path, lenses: str, shots: str) -> None:
    """Replace the COLMAP model of a copy by a model in text format."""
    (root / "sparse/0/cameras.txt").write_text(lenses)
    (root / "sparse/0/images.txt").write_text(shots)
    for name in ("cameras", "images"):
        (root / f"sparse/0/{name}.bin").unlink()


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    """Return a function that copies a stub scene into the test's folder and returns its path."""

    def run(scene: str, to: str | None = None) -> Path:
        shutil.copytree(STUBS / scene, tmp_path / (to or scene))
        return tmp_path / (to or scene)

    return run
