"""How `make test-all` gets torch: once for all checkouts, whole or not at all, its weight said in a line."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests import with_torch


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[list[str]]:
    """Return the calls of a pip that installs one file of 200 MB, in an environment without torch."""
    found: list[list[str]] = []

    def pip(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        found.append(words)
        target = Path(words[words.index("--target") + 1])
        target.mkdir()
        with (target / "torch.so").open("wb") as file:
            file.truncate(200_000_000)
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(with_torch, "find_spec", lambda _: None)
    monkeypatch.setattr(subprocess, "run", pip)
    return found


def test_torch_is_installed_once_and_its_weight_is_said(
    calls: list[list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder,) = {with_torch.packages() for _ in range(2)}
    assert len(calls) == 1
    assert calls[0][-2].startswith("torch>=")
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]
    assert [path.name for path in folder.iterdir()] == ["torch.so"]
    out = capsys.readouterr().out.splitlines()
    assert out[1:] == 2 * [f"the extra lpips, for tests: 0.2 GB, kept in {folder}"]


def test_what_cannot_be_installed_is_one_line_and_leaves_nothing(
    calls: list[list[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        Path(words[words.index("--target") + 1]).mkdir()
        return subprocess.CompletedProcess(words, 1, "", "WARNING: offline\nERROR: No such package")

    monkeypatch.setattr(subprocess, "run", fails)
    assert with_torch.packages() is None
    assert capsys.readouterr().err == (
        "the extra lpips cannot be installed here: its tests will be skipped (ERROR: No such package)\n"
    )
    assert not calls
    assert not [*(tmp_path / "cache" / "meshsplatbench").iterdir()]


def test_an_environment_with_torch_is_left_alone(
    calls: list[list[str]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(with_torch, "find_spec", lambda name: name)
    assert with_torch.packages() is None
    assert not calls
    assert not any(capsys.readouterr())
