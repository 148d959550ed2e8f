"""Write the tables at the end of docs/datasets.md: `python -m docs.make_datasets`."""

from __future__ import annotations

from pathlib import Path

from msb.scenes.datasets import DATASETS, RULES, Photographs, color_name

PAGE = Path(__file__).with_name("datasets.md")
BEGIN = "<!-- Made by `python -m docs.make_datasets` from msb/scenes/datasets: change that, not this. -->\n"
_COMPOSITING = {
    "before_resize": ", mask applied, then resized",
    "after_resize": ", resized, then mask applied",
    "none": "",
}


def page() -> str:
    """Return docs/datasets.md: what is written there by hand, and the tables made anew."""
    by_hand, _, _ = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{by_hand}{BEGIN}\n{datasets()}\n{rules()}"


def datasets() -> str:
    """Return the table of datasets and their scenes."""
    lines = ["| dataset | scenes | over | folder above |", "|---|---|---|---|"]
    for key, dataset in DATASETS.items():
        groups: dict[str, list[str]] = {}
        for scene, group in dataset.scenes.items():
            groups.setdefault(group, []).append(scene)
        scenes = "; ".join(f"{group + ': ' if group else ''}{' '.join(s)}" for group, s in groups.items())
        over = "the method's own" if dataset.background is None else color_name(dataset.background)
        lines.append(f"| `{key}` | {scenes} | {over} | {', '.join(dataset.folders)} |")
    return "\n".join(lines) + "\n"


def rules() -> str:
    """Return a table with a column for each dataset and a row for each loader, and one of the rest."""
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
    return "\n".join(lines) + "\n"


def _photographs(rule: Photographs | None) -> str:
    if rule is None:
        return "--"
    place = "as named" if rule.folder == "." else f"`{rule.folder}`"
    size = "" if rule.resolution == -1 else f" -r {rule.resolution}"
    instead = "" if rule.instead is None else f", else `{rule.instead[0]}` / {rule.instead[1]}"
    return f"{place}{size}{_COMPOSITING[rule.compositing]}{instead}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
