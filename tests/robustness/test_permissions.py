"""Places that may not be written, and inputs that may not be read."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.conftest import ROOT

if TYPE_CHECKING:
    from tests.cli.conftest import Here

    Refused = Callable[..., tuple[int, str]]

pytestmark = pytest.mark.slow

ASSET = ROOT / "data_stubs" / "splat_like.triasset"
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
TURN = ("render", "--turntable", 1, "--size", "64x48")
_LIKE_ANYBODY = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner")
"""For root, whom the system refuses nothing otherwise."""


@pytest.fixture
def refused() -> Refused:
    """Return a function that runs `msb` as somebody whom permissions bind; status and standard error."""
    if os.name == "nt":
        pytest.skip("permissions are POSIX")
    before: tuple[str, ...] = ()
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root is refused nothing, and there is no setpriv to change that")
        before = _LIKE_ANYBODY

    def run(*args: object, **variables: str) -> tuple[int, str]:
        done = subprocess.run(
            [*before, sys.executable, "-m", "msb", *map(str, args)],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env={**os.environ, **variables},
            check=False,
        )
        return done.returncode, done.stderr

    return run


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Path]:
    """A folder with an asset in it, into which nobody may look or write."""
    folder = tmp_path / "locked"
    folder.mkdir()
    shutil.copy(ASSET, folder / "a.triasset")
    folder.chmod(0)
    yield folder
    folder.chmod(stat.S_IRWXU)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder into which nobody may write."""
    folder = tmp_path / "read_only"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    yield folder
    folder.chmod(stat.S_IRWXU)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.triasset", lambda out: ["export", CHECKPOINT, out]),
        ("00000.png", lambda out: [*TURN, "-o", out.parent, CHECKPOINT]),
        ("t.json", lambda out: ["track", "-o", out, "--", sys.executable, "-c", "print('it ran')"]),
    ],
    ids=["export", "render", "track"],
)
def test_a_folder_that_is_read_only_is_noticed_first(
    refused: Refused, read_only: Path, name: str, line: Callable[[Path], list[object]]
) -> None:
    status, err = refused(*line(read_only / name))
    said = f"OUTPUT_UNWRITABLE: {read_only / name}: it cannot be written: Permission denied: {read_only}\n"
    assert (status, err) == (3, said)


def test_an_input_that_may_not_be_read(refused: Refused, locked: Path) -> None:
    for line in (["audit", locked / "a.triasset"], ["convert", locked / "a.ply", locked.parent / "b.glb"]):
        status, err = refused(*line)
        assert (status, err) == (3, f"FILE_UNREADABLE: {line[1]}: it cannot be read: Permission denied\n")
    # One folder that may not be looked into does not stop the others.
    shutil.copy(ASSET, locked.parent / "b.triasset")
    status, err = refused("audit", "--jsonl", locked.parent / "out.jsonl", locked.parent)
    assert (status, err.count("\n"), err.split(":")[0]) == (3, 1, "FILE_UNREADABLE")
    assert (locked.parent / "out.jsonl").read_text().count("msb.audit/1") == 2


def test_results_of_somebody_else(refused: Refused, tmp_path: Path) -> None:
    file = protocol(tmp_path, ("two_dts",))
    (tmp_path / "protocol.toml").write_bytes(file.text)
    assert run_protocol(file, only=["exported_mesh"]).exit_status == 0
    before = {path: path.stat().st_mtime_ns for path in file.results.rglob("*")}
    for path in (file.results, *before):
        if os.geteuid() == 0:
            os.chown(path, 65534, 65534)
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        status, err = refused("run", tmp_path / "protocol.toml")
        said = f"OUTPUT_UNWRITABLE: {file.results}: it cannot be locked: Permission denied\n"
        assert (status, err) == (3, said)
        assert refused("run", "--dry-run", tmp_path / "protocol.toml")[0] == 0
        status, err = refused("report", file.results)
        where = file.results / "report"
        said = f"OUTPUT_UNWRITABLE: {where}: it cannot be written: Permission denied: {file.results}\n"
        assert (status, err) == (3, said)
        assert {path: path.stat().st_mtime_ns for path in file.results.rglob("*")} == before
    finally:
        for path in (file.results, *before):
            if path.is_dir():
                path.chmod(0o755)


def test_a_cache_that_is_read_only(
    refused: Refused, read_only: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    status, err = refused("devices", "-q", XDG_CACHE_HOME=str(read_only))
    assert status == 0
    assert "DEVICE_" not in err  # a library of the system's may complain, too


def test_what_stands_in_the_way(here: Here, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"kept")
    target = tmp_path / "file" / "new" / "a.glb"
    result = here("convert", ASSET, target)
    said = f"OUTPUT_UNWRITABLE: {target}: it cannot be written: {tmp_path / 'file'} is no folder\n"
    assert (result.status, result.err) == (3, said)
    assert (tmp_path / "file").read_bytes() == b"kept"

    (tmp_path / "folder.glb").mkdir()
    assert here("convert", ASSET, tmp_path / "folder.glb").status == 2
    result = here("convert", "-f", ASSET, tmp_path / "folder.glb")
    said = f"OUTPUT_UNWRITABLE: {tmp_path / 'folder.glb'}: it is a folder; a file is to be written\n"
    assert (result.status, result.err) == (3, said)

    target = tmp_path / f"{'n' * 300}.glb"
    result = here("convert", ASSET, target)
    said = f"OUTPUT_UNWRITABLE: {target}: it cannot be written: File name too long\n"
    assert (result.status, result.err) == (3, said)
    assert here("convert", ASSET, tmp_path / f"{'n' * 251}.glb").status == 0


@pytest.mark.skipif(os.name == "nt", reason="links need a right of their own there")
def test_a_link_is_replaced_and_what_it_points_to_is_not(here: Here, tmp_path: Path) -> None:
    (tmp_path / "kept").write_bytes(b"kept")
    for name, points_to in (("dangling.glb", "nowhere"), ("link.glb", "kept")):
        link = tmp_path / name
        link.symlink_to(tmp_path / points_to)
        result = here("convert", ASSET, link)
        assert (result.status, result.err.split(":")[0]) == (2, "OUTPUT_EXISTS")
        assert here("convert", "-f", ASSET, link).status == 0
        assert not link.is_symlink()
    assert (tmp_path / "kept").read_bytes() == b"kept"
    assert not (tmp_path / "nowhere").exists()
