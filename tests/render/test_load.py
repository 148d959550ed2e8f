"""Several commands that start at once on one machine, like in a script that loops over models."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.slow

PROCESSES = 2


def start(folder: Path, number: int, cache: Path) -> subprocess.Popen[bytes]:
    """Start a rendering of two views into a separate folder."""
    return subprocess.Popen(
        [
            *(sys.executable, "-m", "msb", "render", "--turntable", "2", "--size", "64x48", "--json", "-"),
            *("-o", str(folder / str(number)), "data_stubs/splat_like.triasset"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        env={**os.environ, "POCL_CACHE_DIR": str(cache)},
    )


def read_hashes(process: subprocess.Popen[bytes]) -> list[str]:
    """Return the hash of each view after the process has succeeded."""
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, b"")
    return [row["sha256"] for row in json.loads(out)["frames"]]


def test_simultaneous_renderings_with_an_empty_cache_match_a_single_one(tmp_path: Path) -> None:
    together = [start(tmp_path / "together", number, tmp_path / "cache") for number in range(PROCESSES)]
    results = [read_hashes(process) for process in together]
    alone = read_hashes(start(tmp_path / "alone", 0, Path(os.environ["POCL_CACHE_DIR"])))
    assert len(alone) == 2
    assert results == [alone] * PROCESSES
    images = {
        path.relative_to(tmp_path / "alone" / "0"): path for path in (tmp_path / "alone").rglob("*.png")
    }
    assert images
    for number in range(PROCESSES):
        for name, path in images.items():
            assert (tmp_path / "together" / str(number) / name).read_bytes() == path.read_bytes()
