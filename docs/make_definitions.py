"""Write the reference section of docs/definitions.md: `python -m docs.make_definitions`."""

from __future__ import annotations

import textwrap
from pathlib import Path

from msb.topology.explain import EXPLANATIONS

PAGE = Path(__file__).with_name("definitions.md")
BEGIN = "<!-- Made by `python -m docs.make_definitions` from msb/topology/explanations.toml. -->\n"


def page() -> str:
    """Return docs/definitions.md: what is written there by hand, and the reference made anew."""
    by_hand, _, _ = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{by_hand}{BEGIN}\n{reference()}"


def reference() -> str:
    """Return one table of all quantities, then a section for each."""
    lines = ["| key | symbol | meaning | formula |", "|---|---|---|---|"]
    for entry in EXPLANATIONS.values():
        symbol = f"`{entry.symbol}`" if entry.symbol else ""
        formula = entry.formula.replace("|", "\\|")
        lines.append(f"| [`{entry.name}`](#{entry.name}) | {symbol} | {entry.title} | {formula} |")
    for entry in EXPLANATIONS.values():
        lines += ["", f"### {entry.name}", "", *_wrap(f"**{_sentence(entry.title)}** {entry.definition}"), ""]
        for label, text in entry.paragraphs():
            lines += _wrap(f"- *{label}*: {text}", indent="  ")
    return "\n".join(lines) + "\n"


def _sentence(title: str) -> str:
    return f"{title[0].upper()}{title[1:]}."


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, 110, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
