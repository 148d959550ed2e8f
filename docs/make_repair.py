"""Measure trials and repairs of meshes for docs/trial.md and docs/repair.md: `python -m docs.make_repair`.

    python -m docs.make_repair                      all models of data_stubs, and a torus
    python -m docs.make_repair splat_like torus     these alone
    python -m docs.make_repair vase=mesh.ply        a mesh of your own, by a title of `TITLES`

What was measured is kept in docs/repair_figures.json, from which the tables of both pages are made; a mesh
that is not measured again keeps its figures. The pictures are of `PICTURED`.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import msb
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.repair.plan import Options
from msb.topology.shown import structure_text
from msb.trial.repairs import compare
from msb.trial.run import try_asset
from msb.views import choose_views

HERE = Path(__file__).parent
STUBS = HERE.parent / "data_stubs"
FIGURES, IMAGES = HERE / "repair_figures.json", HERE / "images"
BEGIN, END = "<!-- Made by `python -m docs.make_repair`: change that, not this. -->\n", "<!-- End. -->\n"
TITLES = {
    "torus": "torus, closed",
    "pebble_mesh_splatting": "`pebble/mesh_splatting`",
    "walled_mesh_splatting": "`walled/mesh_splatting`",
    "pebble_two_dts": "`pebble/two_dts`, soup",
    "pebble_triangle_splatting": "`pebble/triangle_splatting`, soup",
    "splat_like": "`splat_like`",
    "vase": "a vase trained by a user of leonhardrobin/triangle-splatting2",
}
"""Name -> title, in the order of the tables. A new model is a line here, also one of data_stubs/models."""
COMPARED = ("torus", "walled_mesh_splatting", "splat_like", "vase")
"""Of these the repairs are compared."""
PICTURED = {
    "torus": ("uv", "decimate_25", "collision", "solid"),
    "splat_like": ("uv", "decimate_25", "subdivide", "solid"),
}
"""Mesh -> the tasks in its row of docs/images/trial.png."""
SHOWN = ("orient-pair", "cut-by-igl", "drop-orient", "orient-pair-close")
"""The strategies in docs/images/repair.png."""
TILE = (300, 225)
MARKS = {"works": "+", "care": "~", "fails": "-", "not_run": "not run"}


def paths() -> dict[str, Path]:
    """Return where the meshes are that are kept here."""
    models = {f"{path.parent.name}_{path.name}": path for path in (STUBS / "models").glob("*/*")}
    known = {name: path for name, path in models.items() if name in TITLES}
    return {**known, "splat_like": STUBS / "splat_like.triasset"}


def torus(around_it: int = 48, through: int = 24) -> msb.Asset:
    """Return a closed mesh of 2,304 faces, coloured by its direction."""
    u, v = np.meshgrid(np.arange(around_it), np.arange(through), indexing="ij")
    a, b = 2 * np.pi * u / around_it, 2 * np.pi * v / through
    places = np.stack(
        [(1 + 0.4 * np.cos(b)) * np.cos(a), 0.4 * np.sin(b), (1 + 0.4 * np.cos(b)) * np.sin(a)], -1
    )
    here, right, up, both = (
        (u + i) % around_it * through + (v + k) % through for i, k in ((0, 0), (1, 0), (0, 1), (1, 1))
    )
    faces = np.concatenate([np.stack([here, up, right], -1), np.stack([right, up, both], -1)]).reshape(-1, 3)
    points = places.reshape(-1, 3).astype(np.float32)
    return asset_from_mesh(Mesh(points, faces, (0.5 + points / 3).astype(np.float32)))


def measure(asset: msb.Asset, name: str, pictures: Path) -> dict[str, Any]:
    """Return the audit's verdict, the trials, and the repairs where they are compared; write pictures."""
    pictures.mkdir()
    found: dict[str, Any] = {"faces": asset.manifest.face_count, "verdict": msb.audit(asset).verdict}
    views = choose_views(asset, size=(960, 720))
    tried = try_asset(asset, cameras=views, keep=pictures, meshes=False).to_dict()
    keys = ("task", "outcome", "why", "seconds", "numbers", "libraries")
    found["trials"] = [{key: one[key] for key in keys} for one in tried["trials"]]
    if name in COMPARED:
        rows = compare(asset, views, Options(), keep=pictures)
        found["repairs"] = [row.to_dict() for row in rows]
    return found


def _decimation(numbers: dict[str, Any]) -> str:
    best = numbers.get(numbers.get("best", "").replace("-", "_"), {})
    return "" if best.get("psnr") is None else f"{best['psnr']:.0f} dB"


def _cracks(numbers: dict[str, Any]) -> str:
    if numbers["lone_share"] > 0.5:
        return f"{100 * numbers['lone_share']:.0f} % lone"
    return f"cracks {100 * numbers['gap_share']:.2g} %" if numbers["gap_share"] else ""


def _collision(numbers: dict[str, Any]) -> str:
    kind = "mesh" if numbers.get("best") == "pymeshlab" else "hull"
    shape = f"{kind} of {numbers['faces']:,}" if "instead" in numbers else f"{numbers['parts']} parts"
    return f"{shape}, {100 * (numbers['empty_share'] or 0):.0f} % in mid-air"


def _crossing(numbers: dict[str, Any]) -> str:
    return f"{100 * numbers['face_share']:.0f} % cross" if numbers["face_share"] else ""


SHORT: dict[str, Callable[[dict[str, Any]], str]] = {
    "uv": lambda numbers: f"{numbers['charts']:,}",
    **dict.fromkeys(("decimate_50", "decimate_25", "decimate_10"), _decimation),
    "subdivide": _cracks,
    "boolean": lambda _: "",
    "collision": _collision,
    "solid": lambda _: "",
    "self_intersections": _crossing,
}
"""Task -> a few words from its numbers."""


def trial_table(figures: dict[str, Any]) -> str:
    """Return the table of docs/trial.md."""
    heads = ("mesh", "faces", "verdict", *(name.replace("_", " ") for name in SHORT))
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, title in TITLES.items():
        if name in figures:
            own = figures[name]
            cells = [title, f"{own['faces']:,}", own["verdict"].upper(), *map(_trial_cell, own["trials"])]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _trial_cell(one: dict[str, Any]) -> str:
    failed = one["numbers"].get("failed", {})
    if one["outcome"] == "fails" and len(one["numbers"]) == 1 and failed:
        ended = next(iter(failed.values()))
        return f"- not within {ended['seconds']:.0f} s" if ended["ended_by"] == "time" else "-"
    said = SHORT[one["task"]](one["numbers"]) if one["outcome"] != "not_run" else ""
    return f"{MARKS[one['outcome']]} {said}".strip()


def repair_tables(figures: dict[str, Any]) -> str:
    """Return the tables of docs/repair.md, one for each mesh whose repairs are compared."""
    heads = ("strategy", "faces kept", "added", "edges cut", "components", "boundary", "verdict", "tasks")
    heads += ("standard", "dedicated", "MB", "seconds")
    parts = []
    for name, title in TITLES.items():
        rows = figures.get(name, {}).get("repairs")
        if rows:
            lines = [f"**{title[:1].upper()}{title[1:]}**, {figures[name]['faces']:,} faces:", ""]
            lines += [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
            lines += [f"| {' | '.join(_repair_cells(row, rows[0]))} |" for row in rows]
            parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _repair_cells(row: dict[str, Any], stored: dict[str, Any]) -> list[str]:
    if row["why"] is not None:
        code = row["why"].partition(":")[0]
        return [row["strategy"], "nothing left" if code == "TRIASSET_EMPTY" else f"`{code}`", *[""] * 10]
    ratio = row["boundary_edge_ratio"]
    return [
        row["strategy"],
        f"{100 * row['faces_kept'] / stored['faces_kept']:.3g} %",
        f"{row['faces_added']:,}",
        f"{row['edges_cut']:,}",
        f"{row['components']:,}",
        "" if ratio is None else structure_text("boundary_edge_ratio", ratio),
        row["verdict_after"].upper(),
        f"{row['trials_passed_after']} of {len(row['trials'])}",
        *(_look(row["looks"][tier]) for tier in ("standard", "dedicated")),
        f"{row['bytes'] / 1e6:.2f}",
        f"{row['seconds']:.1f}",
    ]


def _look(look: dict[str, Any]) -> str:
    return "same" if look["same"] else "" if look["psnr"] is None else f"{look['psnr']:.1f}"


def page(name: str, made: str) -> str:
    """Return a page with what is between its two marks made anew."""
    text = (HERE / name).read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}"


def sheet(rows: list[list[Path]]) -> Image.Image:
    """Return pictures side by side, each cut to the middle of what it shows."""
    width, height = TILE
    made = Image.new("RGB", (width * max(map(len, rows)), height * len(rows)), "white")
    for number, row in enumerate(rows):
        for column, path in enumerate(row):
            picture = Image.open(path).convert("RGB")
            if picture.width > 2 * picture.height:  # two libraries side by side: the first
                picture = picture.crop((0, 0, picture.width // 2, picture.height))
            picture.thumbnail((width - 6, height - 6), Image.Resampling.LANCZOS)
            place = (
                column * width + (width - picture.width) // 2,
                number * height + (height - picture.height) // 2,
            )
            made.paste(picture, place)
    return made.quantize(128, dither=Image.Dither.NONE)


def main() -> None:
    """Measure what is asked for, and make the tables, and the pictures whose meshes were measured."""
    given = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    wanted = [word for word in sys.argv[1:] if "=" not in word]
    sources: dict[str, Path | None] = {
        "torus": None,
        **paths(),
        **{name: Path(at) for name, at in given.items()},
    }
    names = [*wanted, *given] or list(sources)
    figures = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in names:
            source = sources[name]
            asset = torus() if source is None else msb.open(source)
            figures[name] = measure(asset, name, folder / name)
            text = json.dumps(figures, indent=1, sort_keys=True)
            FIGURES.write_text(f"{text}\n", encoding="utf-8")
        if set(PICTURED) <= set(names):
            tried = [[folder / name / f"{task}.png" for task in tasks] for name, tasks in PICTURED.items()]
            sheet(tried).save(IMAGES / "trial.png", optimize=True)
        if "splat_like" in names:
            ways = [folder / "splat_like" / f"{way}.png" for way in SHOWN]
            sheet([ways]).save(IMAGES / "repair.png", optimize=True)
    (HERE / "trial.md").write_text(page("trial.md", trial_table(figures)), encoding="utf-8")
    (HERE / "repair.md").write_text(page("repair.md", repair_tables(figures)), encoding="utf-8")


if __name__ == "__main__":
    main()
