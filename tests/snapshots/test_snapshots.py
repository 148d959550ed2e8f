"""Help and usual output are as in the files that `python -m tests.snapshots` writes."""

from pathlib import Path

import pytest

from msb.cli.commands import BUILT_IN
from tests.conftest import of_the_whole
from tests.snapshots import FOLDER, USUAL, help_text, names, parts, usual_text

NAMES = [name for places in BUILT_IN.values() for name in places]


def test_each_command_has_a_file_and_no_file_is_left_over() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == {"msb", *NAMES}


@pytest.mark.parametrize("command", [pytest.param("", marks=of_the_whole), *names()])
def test_the_help_is_as_stored(command: str) -> None:
    stored, _ = parts(command)
    text = help_text(command)
    assert text == stored
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.slow
@pytest.mark.parametrize("command", [name for name in names() if name in USUAL])
def test_the_usual_output_is_as_stored(command: str, tmp_path: Path) -> None:
    text = usual_text(command, tmp_path)
    if "EXTRA_MISSING" in text:
        pytest.skip(text.partition("EXTRA_MISSING: ")[2].partition("\n")[0])
    _, stored = parts(command)
    assert text == stored
