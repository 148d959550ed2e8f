"""No word is broken at the end of a line, in tables as in sentences."""

from __future__ import annotations

import io
import os
import re

import pytest

from msb.base.paths import shell_word
from msb.cli.output import plain_table
from msb.cli.whole_words import WholeWordConsole

WORDS = ("pthread-haswell-AMD", "SCENE_IMAGE_MISSING", "of", "a", "photograph")


@pytest.mark.parametrize("width", [30, 50, 80])
def test_tables_and_sentences_keep_their_words(width: int) -> None:
    console = WholeWordConsole(width=width, file=io.StringIO(), highlight=False)
    table = plain_table("Name", "What", "Why")
    table.add_row(" ".join(WORDS), "yes", " ".join(reversed(WORDS)))
    console.print(table)
    console.print(" ".join(WORDS * 4))
    text = console.file.getvalue()
    found = re.findall(r"\S+", text)
    assert {*found} <= {*WORDS, "Name", "What", "Why", "yes"}
    sentence = text.splitlines()[-3:]
    assert all(len(line) <= max(width, max(map(len, WORDS))) for line in sentence)


def test_a_table_that_fits_is_not_wider_than_the_terminal() -> None:
    console = WholeWordConsole(width=80, file=io.StringIO(), highlight=False)
    table = plain_table("File", "Verdict", "First reason")
    table.add_row("data/mesh.ply", "LIMITED", " ".join(["open: 24 boundary edges"] * 6))
    console.print(table)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[1].startswith("data/mesh.ply  LIMITED  ")


@pytest.mark.skipif(os.name == "nt", reason="a backslash is a separator there")
def test_hints_are_quoted_for_every_shell() -> None:
    assert shell_word("out/results") == "out/results"
    assert shell_word("my results") == '"my results"'
    assert shell_word("price$") == "'price$'"
    assert shell_word("") == "''"
    assert shell_word("-d.ply") == os.path.join(".", "-d.ply")  # noqa: PTH118 - Path leaves out the dot
