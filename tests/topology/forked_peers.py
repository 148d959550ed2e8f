"""Peers asked in processes that are forked from one that has imported them: fresh, and started at once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.topology.crosscheck import children
from tests.conftest import ROOT

if TYPE_CHECKING:
    from msb.topology.crosscheck.children import Reply

SERVER = """
import gc, json, os, signal, sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from msb.topology.crosscheck.children import serve
from msb.topology.crosscheck.peers import PEERS
for peer in PEERS.values():
    if find_spec(peer.module):
        import_module(peer.module)
gc.freeze()
answers = os.fdopen(os.dup(1), "w")
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # PyMeshLab prints
for line in sys.stdin:
    peer, folder, seconds = json.loads(line)
    if not (child := os.fork()):
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=answers, flush=True)
else:
    sys.exit()
signal.alarm(seconds)
os.dup2(os.open(f"{folder}/{peer}.err", os.O_WRONLY | os.O_CREAT), 2)
serve(peer, Path(folder))
os._exit(0)  # cleaning up what was imported takes half a second
"""


class ForkedPeers:
    """The process that is forked; `ask` stands in for `ask_peers`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            # A second thread, of a library for linear algebra, would not live on in a child.
            env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )

    def ask(
        self, names: Sequence[str], vertices: Any, faces: Any, timeout: float = 60
    ) -> dict[str, Reply | str]:
        """Return each peer's reply about a mesh, or a sentence that says why there is none."""
        replies = {}
        for peer in names:
            with tempfile.TemporaryDirectory() as name:
                children.leave_mesh(Path(name), vertices, faces)
                assert self._process.stdin is not None
                assert self._process.stdout is not None
                self._process.stdin.write(json.dumps([peer, name, int(timeout) + 1]) + "\n")
                self._process.stdin.flush()
                status = int(self._process.stdout.readline())
                replies[peer] = children._reply(peer, Path(name), status)
        return replies

    def close(self) -> None:
        """End it with its input."""
        self._process.communicate()
