"""Each peer in a process of its own: a crash, a hang or nonsense costs that peer and nothing else."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.topology import audit_arrays
from msb.topology.crosscheck import PEERS, children, cross_check
from msb.topology.crosscheck.children import Reply, ask_peers
from tests.conftest import BOOK


def test_peer_that_crashes_is_skipped_with_the_signal(child: Callable[[str], None]) -> None:
    child("import os; os.abort()")
    result = cross_check(*BOOK, *audit_arrays(*BOOK))
    assert result.rows == ()
    assert {why for peer, why in result.skipped.items() if find_spec(PEERS[peer].module)} == {
        "it crashed (SIGABRT)"
    }


@pytest.mark.slow
def test_peer_that_hangs_is_ended_and_skipped(child: Callable[[str], None]) -> None:
    child("import time; time.sleep(600)")
    start = time.monotonic()
    replies = ask_peers(["libigl", "trimesh"], *BOOK, timeout=0.3)
    assert set(replies.values()) == {"it did not answer within 0.3 s"}
    assert time.monotonic() - start < 30


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise ImportError('libGL.so.1 is missing')", "status 1: ImportError: libGL.so.1 is missing"),
        ("pass", "it ended with status 0"),
        ("(folder / f'{peer}.json').write_text('{')", "it ended with status 0"),
        ("(folder / f'{peer}.json').write_text('[]')", "it ended with status 0"),
        ("import sys; sys.exit('x' * 10000)", "it ended with status 1: xxx"),
    ],
)
def test_peer_that_fails_is_skipped_with_its_last_words(
    child: Callable[[str], None], code: str, reason: str
) -> None:
    child(code)
    (why,) = ask_peers(["trimesh"], *BOOK, timeout=60).values()
    assert isinstance(why, str)
    assert reason in why
    assert len(why) < 300


@pytest.mark.slow
def test_one_crashing_peer_costs_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = children.command

    def command(peer: str, folder: Path) -> list[str]:
        return [sys.executable, "-c", "import os; os.abort()"] if peer == "libigl" else honest(peer, folder)

    monkeypatch.setattr(children, "command", command)
    replies = ask_peers(["libigl", "trimesh"], *BOOK, timeout=60)
    assert replies["libigl"] == "it crashed (SIGABRT)"
    assert isinstance(replies["trimesh"], Reply)


def test_interrupt_ends_the_children(child: Callable[[str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    child("import time; time.sleep(600)")
    started = []
    honest = children._start

    def start(peer: str, folder: Path) -> Any:
        started.append(honest(peer, folder))
        return started[-1]

    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(children, "_start", start)
    monkeypatch.setattr(children.time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        ask_peers(["libigl", "trimesh", "NetworkX"], *BOOK, timeout=60)
    assert len(started) == children.AT_ONCE
    assert all(process.poll() is not None for process in started)


@pytest.mark.slow
def test_child_does_not_run_files_of_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trimesh.py").write_text("raise SystemExit('taken over')")
    (tmp_path / "numpy.py").write_text("raise SystemExit('taken over')")
    monkeypatch.chdir(tmp_path)
    assert isinstance(ask_peers(["trimesh"], *BOOK, timeout=60)["trimesh"], Reply)


def test_children_get_the_mesh_without_pickle(child: Callable[[str], None]) -> None:
    child(
        "import numpy as np, json\n"
        "v = np.load(folder / 'vertices.npy', allow_pickle=False); f = np.load(folder / 'faces.npy')\n"
        "answers = {'v': [v.dtype.str, *v.shape], 'f': [f.dtype.str, *f.shape]}\n"
        "(folder / f'{peer}.json').write_text(json.dumps({'version': '1', 'answers': answers}))"
    )
    reply = ask_peers(["trimesh"], BOOK[0], BOOK[1].astype(np.int32), timeout=60)["trimesh"]
    assert isinstance(reply, Reply)
    assert reply.answers == {"v": ["<f8", 5, 3], "f": ["<i8", 3, 3]}
