"""Compare images of our GLB files in engines, under default settings, with the standard tier.

    python -m benchmarks.opened_in                              all scenes, all installed engines
    python -m benchmarks.opened_in --engines three.js Godot\\ 3  these engines only
    python -m benchmarks.opened_in --pictures out/opened_in     also keep every image

`make engines` installs all engines except Blender. The program prints the tables of
benchmarks/pages/opened.md. `--json` writes the figures.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
from math import inf, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

import msb
from benchmarks.measure import keep, machine
from benchmarks.opened_in.engines import ENTRIES, NOT_RUN
from benchmarks.opened_in.scenes import SCENES
from msb.errors import MsbError, shorten
from msb.meshes import write_mesh
from msb.meshes.assets import mesh_from_asset
from msb.meshes.formats import Style, Web
from msb.render.frame import interior

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.opened_in.scenes import Scene
    from msb.render import Frame

BLACK = (0.0, 0.0, 0.0)
FILES = {"portable": Style(), "web": Style(texture="webp", web=Web())}
"""Files to open: the GLB for all programs, and the compressed GLB for the web."""


def compare(theirs: NDArray[np.uint8], ours: Frame) -> dict[str, float]:
    """Return the difference between an image and ours: in levels for pixels in the interior of faces, and as
    PSNR.
    """
    assert ours.face_id is not None
    picture = np.clip(ours.image.astype(np.float64), 0, 1)
    levels = np.abs(theirs - np.round(255 * picture)).max(axis=2)[interior(ours.face_id)]
    error = float(((theirs / 255 - picture) ** 2).mean())
    return {
        "median": float(np.median(levels)),
        "p999": float(np.percentile(levels, 99.9)),
        "within_1": float((levels <= 1).mean()),
        "within_2": float((levels <= 2).mean()),
        "db": -10 * log10(error) if error else inf,
    }


def opened(name: str, glb: bytes, scene: Scene, ours: Frame, pictures: Path | None) -> dict[str, Any]:
    """Return the row of an engine: with default settings, and with the corrected settings."""
    entry = ENTRIES[name]
    if missing := entry.engine.missing():
        return {"engine": name, "not_run": missing}
    row: dict[str, Any] = {"engine": name}
    for kind in ("as_it_comes", "mended") if entry.setting else ("as_it_comes",):
        try:
            shown = entry.engine.draw(glb, scene, mended=kind == "mended")
        except (MsbError, OSError, RuntimeError, ValueError, subprocess.TimeoutExpired) as error:
            return {"engine": name, "not_run": f"it fails: {shorten(str(error), 120)}"}
        row["by"] = shown.by
        row[kind] = compare(shown.image, ours)
        if pictures:
            Image.fromarray(shown.image).save(pictures / f"{name}-{kind}.png")
    return row


def cells(row: dict[str, Any], kind: str) -> str:
    """Return the cells of a row."""
    if kind not in row:
        return "| | | | |"
    median, within, most, decibels = (row[kind][key] for key in ("median", "within_1", "p999", "db"))
    return f"| {median:.0f} | {100 * within:.1f} % | {most:.0f} | {decibels:.1f} |"


def print_scene(title: str, rows: list[dict[str, Any]], interior_pixels: int) -> None:
    """Print the rows of a scene in Markdown. Then print the skipped engines with the reasons."""
    print(f"\n**{title}** ({interior_pixels:,} interior pixels)\n")
    print("| engine | median | within 1 | 99.9 % | dB | corrected: median | within 1 | 99.9 % | dB |")
    print("|---|---|---|---|---|---|---|---|---|")
    missing: dict[str, list[str]] = {}
    for row in rows:
        if "not_run" in row:
            missing.setdefault(row["not_run"], []).append(row["engine"])
        else:
            print(f"| {row['engine']} {cells(row, 'as_it_comes')}{cells(row, 'mended')[1:]}")
    if missing:
        said = "; ".join(f"{', '.join(engines)} ({why})" for why, engines in missing.items())
        print(f"\nNot run: {said}.")
    sys.stdout.flush()


def main() -> None:
    """Open, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--engines", nargs="+", choices=list(ENTRIES), default=list(ENTRIES))
    parser.add_argument("--files", nargs="+", choices=list(FILES), default=list(FILES))
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--pictures", type=Path, help="also write the images into this folder")
    options = parser.parse_args()
    record: dict[str, Any] = {"machine": machine("numpy"), "scenes": {}, "titles": {}}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    versions: dict[str, str] = {}
    for name in options.scenes:
        title, make = SCENES[name]
        scene = make()
        ours = msb.render(scene.asset, scene.camera, tier="standard", background=BLACK)
        for kind in options.files:
            file = io.BytesIO()
            write_mesh(mesh_from_asset(scene.asset), file, suffix=".glb", style=FILES[kind])
            glb = file.getvalue()
            folder = options.pictures and options.pictures / f"{name}-{kind}"
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
                (folder / "model.glb").write_bytes(glb)
                Image.fromarray(np.round(255 * ours.image).astype(np.uint8)).save(folder / "ours.png")
            rows = [opened(engine, glb, scene, ours, folder) for engine in options.engines]
            rows += [{"engine": engine, "not_run": why} for engine, why in NOT_RUN.items()]
            file_title, pixels = (
                f"{title}, {kind} file of {len(glb):,} bytes",
                int(interior(ours.face_id).sum()),
            )
            print_scene(file_title, rows, pixels)
            record["scenes"][f"{name}, {kind}"] = rows
            record["titles"][f"{name}, {kind}"] = f"{file_title}, {pixels:,} interior pixels"
            versions |= {row["engine"]: row["by"] for row in rows if "by" in row}
    print()
    for name, by in versions.items():
        print(f"{name}: {by}")
    print()
    for name in options.engines:
        if ENTRIES[name].why:
            mends = f". Mended by: {ENTRIES[name].setting}" if ENTRIES[name].setting else ""
            print(f"{name}: {ENTRIES[name].why}{mends}")
    different = [name for name in options.engines if ENTRIES[name].why]
    record["differences"] = {
        name: {"why": ENTRIES[name].why, "setting": ENTRIES[name].setting} for name in different
    }
    keep(record, options.json)


if __name__ == "__main__":
    main()
