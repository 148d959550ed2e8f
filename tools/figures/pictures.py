"""Create the images of the README: `python -m tools.figures.pictures`."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import TerminalTheme
from rich.text import Text

import msb
from msb.api.commands.audit_text import print_audit
from msb.cli.output import Cell, Output

ROOT = Path(__file__).parents[2]
WIDTH = 84
PAPER = TerminalTheme(
    (250, 250, 248),
    (35, 38, 42),
    [
        *[(35, 38, 42), (190, 30, 45), (20, 120, 60), (160, 105, 0)],
        *[(30, 80, 170), (130, 50, 140), (0, 120, 130), (120, 124, 130)],
    ],
)
# Like the frame of Textualize/rich (MIT), but without a web font, and without the title bar at its top.
FRAME = """<svg class="rich-terminal" viewBox="0 20 {width} {terminal_height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace;
  font-size: {char_height}px; line-height: {line_height}px; font-variant-east-asian: full-width; }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}"/></clipPath>{lines}</defs>
<rect fill="rgb(250,250,248)" stroke="rgb(200,200,196)" x="1" y="21" width="99.8%"
 height="99.7%" rx="8"/>
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}<g class="{unique_id}-matrix">{matrix}</g></g>
</svg>
"""


class Recorded(Output):
    """Output that a console records. Long lines are wrapped as in a terminal, but between words."""

    def console(self) -> Console:
        return CONSOLE

    def line(self, *parts: Cell) -> None:
        texts = (part if isinstance(part, tuple) else (part, "") for part in parts)
        CONSOLE.print(Text.assemble(*texts))


CONSOLE = Console(record=True, width=WIDTH, file=io.StringIO(), force_terminal=True, highlight=False)


def audit_picture() -> str:
    """Return an SVG of a terminal with the audit of the demo asset."""
    path = ROOT / "data_stubs" / "splat_like.triasset"
    console = CONSOLE
    console.print(f"[bold]$[/bold] msb-audit --paper data_stubs/{path.name}\n")
    audit = replace(msb.audit(msb.load(path)), path=f"data_stubs/{path.name}")
    print_audit(audit, Recorded(), paper=True)
    console.print("\n")  # space below; the last line has no clipping path
    return console.export_svg(theme=PAPER, code_format=FRAME, unique_id="audit")


if __name__ == "__main__":
    (ROOT / "docs" / "images").mkdir(exist_ok=True)
    (ROOT / "docs" / "images" / "audit.svg").write_text(audit_picture())
