"""The bar of a run on a terminal of 80 columns."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from msb.bench.commands.run import stage_lines
from msb.bench.progress import Stage

NAME = "tanksandtemples truck triangle_splatting dedicated"


def shown(stage: Stage) -> list[str]:
    """Return the lines as a terminal of 80 columns has them."""
    text = io.StringIO()
    Console(file=text, width=80, color_system=None, force_terminal=True).print(stage_lines(stage))
    return text.getvalue().splitlines()


@pytest.mark.parametrize(
    ("seconds", "told"),
    [(0.2, "1 s"), (44, "44 s"), (300, "5 min"), (3600, "60 min"), (12_000, "3 h 20 min")],
)
def test_the_first_line_has_the_time_left_and_what_follows(seconds: float, told: str) -> None:
    stage = Stage("cells", [NAME] * 3, "aab", then=["timing", "videos"], clock=lambda: 0.0)
    line, name = shown(stage)
    assert line.split()[:2] == ["cells", "0/3"]
    assert line.endswith(" then timing and videos")
    assert "left" not in line
    stage.end(0, seconds)
    line, name = shown(stage)
    assert line.endswith(f" more than {told} left, then timing and videos")
    assert len(line) == 80
    assert "━" * 5 in line
    assert name.rstrip() == f"  {NAME}"


def test_the_second_line_says_how_many_more_are_computed_and_never_breaks() -> None:
    stage = Stage("cells", [NAME, "b", "c"], "abc", at_once=3)
    assert shown(stage)[1].rstrip() == f"  {NAME} and 2 more"
    assert len(shown(Stage("cells", [NAME * 3], "a"))) == 2
    for number in range(3):
        stage.end(number)
    assert shown(stage)[0].split()[:2] == ["cells", "3/3"]
