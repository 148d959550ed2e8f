"""Tables generated from the code. The site appends them to pages of docs/ (hooks.py).

`python -m tools.site.tables errors` (or definitions, or datasets) prints the tables of docs/errors.md.
"""

from __future__ import annotations

import sys
import textwrap

from msb.errors import EXIT_STATUS, explained_codes
from msb.scenes.datasets import DATASETS, RULES, Photographs, color_name
from msb.topology.explain import EXPLANATIONS

_COMPOSITING = {
    "before_resize": ", mask applied, then resized",
    "after_resize": ", resized, then mask applied",
    "none": "",
}


def datasets() -> str:
    """Return a table of the datasets with their scenes, and a table of the rules by which the methods read
    them.
    """
    lines = ["| dataset | scenes | over | folder above |", "|---|---|---|---|"]
    for key, dataset in DATASETS.items():
        groups: dict[str, list[str]] = {}
        for scene, group in dataset.scenes.items():
            groups.setdefault(group, []).append(scene)
        scenes = "; ".join(f"{group + ': ' if group else ''}{' '.join(s)}" for group, s in groups.items())
        over = "the method's own" if dataset.background is None else color_name(dataset.background)
        lines.append(f"| `{key}` | {scenes} | {over} | {', '.join(dataset.folders)} |")
    return "\n".join([*lines, "", *_rules()])


def _rules() -> list[str]:
    """Return a table with a column for each dataset and a row for each loader, and a table of the other
    rules.
    """
    keys = [
        f"{key}/{group}" if group else key
        for key, dataset in DATASETS.items()
        for group in dict.fromkeys(dataset.scenes.values())
    ]
    lines = [f"| rules | {' | '.join(keys)} | custom |", "|---" * (len(keys) + 2) + "|"]
    for name, loader in RULES.items():
        cells = [_photographs(loader.photographs_of(*key.split("/"))) for key in [*keys, "custom"]]
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    lines += ["", "| rules | camera | sides | filter | sorted by | rounded | over | from |", "|---" * 8 + "|"]
    for name, loader in RULES.items():
        camera = loader.convention + (", first image's" if loader.first_lens else "")
        over = "; ".join(
            f"{key + ': ' if key else ''}{color_name(c)}" for key, c in sorted(loader.backgrounds.items())
        )
        cells = [
            camera,
            loader.rounding.replace("_", " "),
            loader.resampling,
            "stem" if loader.order == "stem" else "full name",
            "8 bits" if loader.quantized else "no",
            over,
            loader.source,
        ]
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return lines


def _photographs(rule: Photographs | None) -> str:
    if rule is None:
        return "--"
    place = "as named" if rule.folder == "." else f"`{rule.folder}`"
    size = "" if rule.resolution == -1 else f" -r {rule.resolution}"
    instead = "" if rule.instead is None else f", else `{rule.instead[0]}` / {rule.instead[1]}"
    return f"{place}{size}{_COMPOSITING[rule.compositing]}{instead}"


def errors() -> str:
    """Return a table of codes for each class of errors."""
    lines = []
    for kind, status in EXIT_STATUS.items():
        of_kind = {name: code for name, code in explained_codes().items() if name in kind.codes}
        if of_kind:
            lines += [f"## `{kind.__name__}`, exit status {status}", "", kind.__doc__ or "", ""]
            lines += ["| code | meaning | remedy |", "|---|---|---|"]
            lines += [f"| `{name}` | {code.summary} | {code.remedy} |" for name, code in of_kind.items()]
            lines.append("")
    return "\n".join(lines)


def definitions() -> str:
    """Return a table of all audited quantities, then a section for each."""
    lines = ["| key | symbol | meaning | formula |", "|---|---|---|---|"]
    for entry in EXPLANATIONS.values():
        symbol = f"`{entry.symbol}`" if entry.symbol else ""
        formula = entry.formula.replace("|", "\\|")
        lines.append(f"| [`{entry.name}`](#{entry.name}) | {symbol} | {entry.title} | {formula} |")
    for entry in EXPLANATIONS.values():
        title = f"{entry.title[0].upper()}{entry.title[1:]}."
        lines += ["", f"### {entry.name}", "", *_wrap(f"**{title}** {entry.definition}"), ""]
        for label, text in entry.paragraphs():
            lines += _wrap(f"- *{label}*: {text}", indent="  ")
    return "\n".join(lines)


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, 110, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


AT_THE_END = {"datasets.md": datasets, "definitions.md": definitions, "errors.md": errors}
"""The tables at the end of each page."""

if __name__ == "__main__":
    sys.stdout.write(AT_THE_END[f"{sys.argv[1]}.md"]() + "\n")
