"""Every reader with hostile bytes: a value or our error, in a process that may do no harm."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.targets import TARGETS
from tests.conftest import ROOT
from tests.fuzz.corpora import write_all

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is capped as Linux does it")
STUCK = 1800
"""Seconds of wall time after which a process that takes no processor time is given up."""


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the driver in the root of the repository, where the package `fuzz` is."""
    command = [sys.executable, "-m", "tests.fuzz.guarded_driver", *arguments]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        command, capture_output=True, text=True, timeout=STUCK, env=environment, cwd=ROOT, check=False
    )


@pytest.mark.slow
def test_every_target_survives_its_seeds_and_mutations_of_them(tmp_path: Path) -> None:
    done = run(tmp_path, *TARGETS)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.startswith(f"{len(TARGETS)} targets, ")  # and nothing was printed by a library


@pytest.mark.slow
def test_reading_bad_files_executes_nothing_opens_nothing_else_and_stays_small(tmp_path: Path) -> None:
    count = write_all(tmp_path / "corpora")
    done = run(tmp_path / "corpora", "corpora")
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout == f"{count} files\n"


@pytest.mark.slow
@pytest.mark.parametrize("deed", ["exec", "write", "child", "socket", "memory", "slow", "error"])
def test_the_guard_sees(deed: str, tmp_path: Path) -> None:
    """A target that does what none may do is found out: the test above can fail."""
    done = run(tmp_path, deed)
    assert done.returncode != 0
    wanted = {
        "exec": "exec of code from '<input>'",
        "write": "opened for writing",
        "child": "forbidden: subprocess.Popen",
        "socket": "forbidden: socket.",
        "memory": "MemoryError",
        "slow": "s of processor time",
        "error": "KeyError",
    }
    assert wanted[deed] in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deed", "seen"), [("import", "import ('this'"), ("read", "beside' opened"), ("compile", "compile (")]
)
def test_the_closed_guard_sees(deed: str, seen: str, tmp_path: Path) -> None:
    path = str(tmp_path / "x")
    (tmp_path / "index.json").write_text(json.dumps([[deed, path, path, "x"]]))
    done = run(tmp_path, "corpora")
    assert done.returncode != 0
    assert f"forbidden: {seen}" in done.stderr or f"{seen} with mode" in done.stderr


# --- prefixes

PREFIXES = {
    "triasset": {"TRIASSET_DAMAGED", "FILE_NOT_RECOGNISED"},
    "checkpoint": {"CHECKPOINT_DAMAGED", "CHECKPOINT_NOT_RECOGNISED"},
    **dict.fromkeys(("ply", "stl", "glb", "colmap_cameras_bin", "colmap_images_bin", "colmap_points_bin")),
    **dict.fromkeys(("transforms_json", "cameras_json", "views_json")),
}
"""Formats that say where they end: target -> the codes of what ends sooner, if few."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PREFIXES)
def test_no_prefix_of_these_is_taken_for_a_whole_file(name: str, tmp_path: Path) -> None:
    feed, whole = TARGETS[name].at(tmp_path), TARGETS[name].small_seeds()[0]
    assert feed(whole) is None
    codes = set()
    for length in range(len(whole.rstrip())):
        error = feed(whole[:length])
        assert error is not None, length
        codes.add(error.code)
    assert PREFIXES[name] in (None, codes)
