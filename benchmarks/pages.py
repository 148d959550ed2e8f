"""Write benchmarks/pages from the JSON files in benchmarks/results: `python -m benchmarks.pages`.

A page holds the results of one benchmark. The name of the page is the first word in the file names of the
results.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path

from benchmarks.official import SCHEMA, tables
from benchmarks.tables import TABLES, Record, generic

HERE = Path(__file__).parent
RESULTS, PAGES, README = HERE / "results", HERE / "pages", HERE / "README.md"
TITLES = {
    "audit": "Speed of the audit",
    "bake": "Baked meshes",
    "before": "Speed against an earlier commit",
    "dedicated": "Speed of the dedicated tier",
    "card": "The paper's tables on a graphics card",
    "delivery": "Compressed GLB files",
    "diffsoup": "DiffSoup on the dedicated tier",
    "endurance": "Resources of long processes",
    "engines": "Engines beside our renderers",
    "export": "Speed and memory of the export",
    "mesh": "Mesh libraries and damaged files",
    "official": "Official checkpoints",
    "opened": "GLB files opened in engines",
    "porting": "Mistakes of a port",
    "primitives": "Scan, sort and scratch buffers",
    "reference": "Reference renderers",
    "repair": "Repairs",
    "scale": "Ten million triangles",
    "significance": "Significance of differences",
    "sizes": "One and four million faces",
    "splats": "Speed of Gaussian splats",
    "standard": "Speed of the standard tier",
    "trained": "Models of our trainer",
    "training": "Speed of our trainer",
    "trial": "Trials",
    "viewer": "The viewer on large meshes",
    "walk": "Flicker along a camera path",
    "weigh": "Weighing faces",
    "why": "Causes of a worse look",
}
"""Titles of the pages, by the first word in the file name of a result. Other words are titles themselves."""
ABOUT = ("what", "measured", "machine", "notes")
"""Keys of a record that are printed above its tables."""


def section(name: str, record: Record) -> str:
    """Return the section of a page that shows one result."""
    parts = [f"## {name}"]
    if isinstance(record.get("what"), str):
        parts.append(f"{record['what']}.")
    facts = [f"Measured {record['measured']}."] if "measured" in record else []
    if "machine" in record:
        machine = dict(record["machine"])
        versions = ", ".join(f"{key} {value}" for key, value in machine.items() if key != "machine")
        facts.append(f"Machine: {machine['machine']}{'; ' if versions else ''}{versions}.")
    notes = "\n".join(f"- {note}" for note in record.get("notes", ()))
    rest = {key: value for key, value in record.items() if key not in ABOUT}
    made = TABLES[name](record) if name in TABLES else generic(rest)
    return "\n\n".join(part for part in (*parts, *facts, notes, *made) if part)


def pages() -> dict[str, str]:
    """Return the text of every page by file name."""
    found: dict[str, list[str]] = {}
    official = []
    for path in sorted(RESULTS.glob("*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        if record.get("schema") == SCHEMA:
            if path.stem != "official-stub":
                official.append(record)
            continue
        found.setdefault(path.stem.partition("-")[0], []).append(section(path.stem, record))
    found.setdefault("official", []).append(f"## Files of benchmarks.official\n\n{tables(official)}")
    return {
        f"{word}.md": "\n\n".join(
            [
                f"# {TITLES.get(word, word.capitalize())}",
                "<!-- Printed by `python -m benchmarks.pages` from benchmarks/results: edit neither. -->",
                *parts,
            ]
        )
        + "\n"
        for word, parts in found.items()
    }


def readme(made: Iterable[str]) -> str:
    """Return the README. It ends with links to these pages."""
    head, mark, _ = README.read_text(encoding="utf-8").partition("## Pages\n")
    titles = {name: TITLES.get(word := Path(name).stem, word.capitalize()) for name in sorted(made)}
    return (
        f"{head}{mark}\n" + "\n".join(f"- [{title}](pages/{name})" for name, title in titles.items()) + "\n"
    )


def main() -> None:
    """Write every page and the links to them, and delete pages whose results are gone."""
    made = pages()
    PAGES.mkdir(exist_ok=True)
    README.write_text(readme(made), encoding="utf-8")
    for path in PAGES.glob("*.md"):
        if path.name not in made:
            path.unlink()
    for name, text in made.items():
        (PAGES / name).write_text(text, encoding="utf-8")
    sys.stdout.write(f"{len(made)} pages in {PAGES.relative_to(HERE.parent)}\n")


if __name__ == "__main__":
    main()
