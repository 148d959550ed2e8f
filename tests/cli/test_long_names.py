"""A name that is too long is an input that cannot be read, or an output that cannot be written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_environments import ASSET, run_all
from tests.conftest import ROOT

LONG = "x" * 260
READING = """
audit L
render -o out --cameras L A
export --config L CHECKPOINT
eval A L
convert L out.ply
run --scene L A
scenes L
web --verify L
"""


@pytest.mark.slow
def test_a_name_that_is_too_long_is_an_input_or_output_that_cannot_be(tmp_path: Path) -> None:
    model = ROOT / "tests" / "tiny" / "models" / "walled" / "two_dts"
    places = {"L": LONG, "A": str(ROOT / ASSET), "CHECKPOINT": str(model)}
    lines = [*READING.split("\n")[1:-1], "demo-data L", "track -o L -- true", "audit --json L A"]
    commands = [tuple(places.get(word, word) for word in line.split()) for line in lines]
    for line, one in zip(lines, run_all(commands, tmp_path), strict=True):
        last = one.err.decode().splitlines()[-1]
        assert one.status == 3, f"{line}: {last}"
        codes = ("FILE_NOT_FOUND: ", "FILE_UNREADABLE: ") if line in READING else ("OUTPUT_UNWRITABLE: ",)
        assert last.startswith(codes), line
