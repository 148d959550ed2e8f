"""Every bad checkpoint has its code, its words in one clear line, and no result."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from msb.adapters.checkpoint import pickle_machine, read_checkpoint
from msb.errors import CheckpointError
from tests.adapters.assemble import GOOD, archive, legacy
from tests.adapters.bad_checkpoints import CASES, write_case
from tests.corpus.refusals import kept, own_words
from tests.fuzz.corpora import LONGEST

WORDS = kept()
CHECKPOINT_CODES = {f"CHECKPOINT_{what}" for what in ("NOT_RECOGNISED", "DAMAGED", "HOSTILE", "FORM")}
"""Those of `read_checkpoint`; the others are about models, and test_bad_models.py has their cases."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_checkpoint_gives_its_code(case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_case(case, tmp_path)
    if case.name == LONGEST:  # the whole of it is for fuzzing
        monkeypatch.setattr(pickle_machine, "MAX_OPCODES", 20_000)
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(path)
    error = caught.value
    assert error.code == case.code
    if case.name != LONGEST:
        assert own_words(error.message) == WORDS[f"checkpoint/{case.name}"]
    line = str(error)
    assert line.isprintable()
    assert line.startswith(f"{case.code}: {path}: ")
    assert len(line) < len(str(path)) + 300
    assert error.__cause__ is None
    assert error.exit_status == 3
    assert (error.pointer or "").isprintable()


@pytest.mark.parametrize("make", [archive, legacy])
def test_what_the_bad_checkpoints_are_made_from_is_good(make, tmp_path: Path) -> None:
    (tmp_path / "good.pt").write_bytes(make())
    value = read_checkpoint(tmp_path / "good.pt")
    assert list(value) == ["w"]
    np.testing.assert_array_equal(value["w"], np.arange(1, 7, dtype=np.float32).reshape(2, 3))


def test_every_code_has_a_case() -> None:
    assert {case.code for case in CASES} == CHECKPOINT_CODES


def test_the_byte_at_fault_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(archive(GOOD.replace(b"OrderedDict", b"OrderedDict_")))
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(tmp_path / "a.pt")
    assert caught.value.code == "CHECKPOINT_HOSTILE"
    assert re.fullmatch(r"data\.pkl byte [0-9]+", caught.value.pointer or "")
    assert GOOD[int(caught.value.pointer.split()[-1]) :].startswith(b"ccollections\n")
