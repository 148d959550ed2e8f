"""Every class of bad checkpoint has its own code, one clear line, and no result."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import msb.errors
from msb.adapters.checkpoint import read_checkpoint
from msb.adapters.checkpoint.archive import MAX_PICKLE
from msb.adapters.checkpoint.names import NAMES
from msb.adapters.checkpoint.pickle_machine import INSTRUCTIONS, MAX_INTEGER_BYTES, MAX_MEMO, MAX_OPCODES
from msb.adapters.checkpoint.structure import MAX_DEPTH, MAX_VALUES
from msb.adapters.checkpoint.tensors import MAX_AXES, StorageType
from msb.adapters.checkpoint.zip_members import MAX_MEMBERS
from msb.errors import CODES, CheckpointError, InputError
from tests.adapters.assemble import GOOD, archive, legacy
from tests.adapters.bad_checkpoints import CASES, file_name, write_all, write_case

MSB = Path(msb.errors.__file__).parent
_ALL = [code for code in CODES if CODES[code].kind is CheckpointError]
CHECKPOINT_CODES = set(_ALL[: _ALL.index("CHECKPOINT_UNKNOWN")])
"""Those of `read_checkpoint`; the ones behind are about models, and test_bad_models.py has their cases."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_checkpoint_gives_its_code(case, tmp_path: Path) -> None:
    path = write_case(case, tmp_path)
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(path)
    error = caught.value
    assert error.code == case.code
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


def test_there_are_many_cases_and_their_names_differ() -> None:
    assert len(CASES) >= 300
    assert len({case.name for case in CASES}) == len({file_name(case) for case in CASES}) == len(CASES)
    assert all(case.title.isprintable() and len(case.title) < 110 for case in CASES)


def test_every_code_has_a_case_and_is_raised_somewhere() -> None:
    assert {case.code for case in CASES} == CHECKPOINT_CODES
    assert all(code.startswith("CHECKPOINT_") for code in CHECKPOINT_CODES)
    sources = [path.read_text() for path in (MSB / "adapters").rglob("*.py")]
    sources.append((MSB / "asset" / "strict_zip.py").read_text())
    named = {code for text in sources for code in re.findall(r"CHECKPOINT_[A-Z0-9_]+[A-Z0-9]", text)}
    # The strict reader leaves the prefix to the policy of its archive.
    named |= {f"CHECKPOINT_{code}" for text in sources for code in re.findall(r'"(ZIP_[A-Z0-9_]+)"', text)}
    named |= {"CHECKPOINT_PICKLE_GLOBAL", "CHECKPOINT_PICKLE_TRUNCATED"}
    assert named >= CHECKPOINT_CODES


def test_the_page_says_what_the_code_does() -> None:
    page = (MSB.parent / "docs" / "checkpoints.md").read_text()
    read = [what for what in NAMES.values() if not (isinstance(what, StorageType) and what.dtype is None)]
    for text in (
        f"the {len(INSTRUCTIONS)} that writing",
        f"list of {len(read)} pairs",
        f"the {len(CASES)} hostile",
        f"| {MAX_PICKLE >> 20} MiB |",
        *(f"| {n:,} |".replace(",", " ") for n in (MAX_OPCODES, MAX_MEMO, MAX_MEMBERS, MAX_VALUES)),
        *(f"| {n} |" for n in (MAX_DEPTH, MAX_INTEGER_BYTES, MAX_AXES)),
    ):
        assert text in page, text


def test_the_corpus_writes_itself_with_an_index(tmp_path: Path) -> None:
    write_all(tmp_path / "a")
    assert len(list((tmp_path / "a").iterdir())) == len(CASES) + 1


@pytest.mark.parametrize("path", ["a\0b", "x" * 300, "\ud800", "nothing/at/all", "."])
def test_a_path_that_is_no_file_is_an_input_error(path: str) -> None:
    with pytest.raises(InputError) as caught:
        read_checkpoint(path)
    assert caught.value.code in ("FILE_NOT_FOUND", "FILE_UNREADABLE")


def test_the_byte_at_fault_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(archive(GOOD.replace(b"OrderedDict", b"OrderedDict_")))
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(tmp_path / "a.pt")
    assert caught.value.code == "CHECKPOINT_PICKLE_GLOBAL"
    assert re.fullmatch(r"data\.pkl byte [0-9]+", caught.value.pointer or "")
    assert GOOD[int(caught.value.pointer.split()[-1]) :].startswith(b"ccollections\n")


def test_reading_bad_checkpoints_executes_nothing_and_stays_small(tmp_path: Path) -> None:
    """All cases in a process of 1 GiB in which any import, exec, socket or foreign file is fatal."""
    write_all(tmp_path / "corpus")
    driver = Path(__file__).with_name("guarded_driver.py")
    (tmp_path / "corpus" / "good.pt").write_bytes(archive())
    command = [sys.executable, str(driver), str(tmp_path / "corpus")]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(MSB.parent)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith(f"{len(CASES)} cases")
