"""Measure the loss of an engine's choices of order and sampling: `python -m tools.figures.losses`.

Every golden view (tests/golden, or the folders given) is drawn on the dedicated tier with each order and
sampling, and compared with the official image at pixels that do not depend on rounding. The synthetic
captures of benchmarks/dedicated.py, which have no official image, are compared with our official rendering.
Prints a table by method, and one by scene. --picture FILE.png also writes an image with one view of each
method.

`python -m tools.figures.losses --causes docs/images` measures the causes of `msb why` on the stub models
instead. It prints their table, and writes an image of each cause with the method that loses most.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import msb
from benchmarks.dedicated_scenes import BLENDED, capture, psnr
from benchmarks.dedicated_scenes import camera as capture_camera
from data_stubs.made_models import TRAINED
from msb.registry import METHODS
from msb.why import CAUSES, EQUAL, why
from tests.golden.views import METHODS as GOLDEN
from tests.golden.views import scenes, views

ROOT = Path(__file__).parents[2]
OFFICIAL = tuple(name for name in TRAINED if name in GOLDEN)
"""Methods that have golden scenes and models in the demo."""
TITLES = {name: METHODS[name].title for name in TRAINED}
CHOICES: dict[str, dict[str, str]] = {
    "`order=global`": {"order": "global"},
    "`order=none`": {"order": "none"},
    "`sampling=engine`": {"sampling": "engine"},
    "both: `engine`, `none`": {"order": "none", "sampling": "engine"},
}
SINGLE = {"supersample": 1}
"""MeshSplatting is also measured with one sample per pixel, as in an engine."""
CAPTURE = 100_000
"""Faces of the synthetic captures."""
SHOWN = ("orb_diffuse/0", "torus_sh0_white/0", "bumpy_sphere_sh3/0", "soup_l1_black_noview/0")

STUBS = ROOT / "data_stubs"
SIZE = 448, 336
"""Size of the views for causes, in pixels."""
GAP = 8
"""Gap between the two halves of such an image, in pixels."""
WIDTH = 900
"""Size of the image of each view, in pixels."""

Figures = dict[str, list[float]]
"""Choice -> PSNR of views in dB."""


class Row(NamedTuple):
    """A row of the longer table; `note` names the changed setting."""

    method: str
    scene: str
    note: str = ""

    def __str__(self) -> str:
        return f"{TITLES[self.method]}, {self.scene}{self.note}"


def draw(asset: msb.Asset, camera: msb.Camera, **options: Any) -> NDArray[np.float32]:
    """Return the image of the dedicated tier."""
    return msb.render(asset, camera, tier="dedicated", outputs=(), **options).image


def golden(roots: list[Path], device: str | None) -> tuple[dict[Row, Figures], list[Any]]:
    """Return the figures by method and scene, and the rows of the image."""
    found: dict[Row, Figures] = {}
    strips = []
    for method in OFFICIAL:
        for scene in (folder for root in roots for folder in scenes(root, method)):
            asset = msb.export(scene / "checkpoint")
            for name, camera, background, settings, official, stable in views(scene, method):
                for changed in ({}, SINGLE) if "supersample" in METHODS[method].settings else ({},):
                    row = Row(method, f"`{scene.name}`", ", one sample a pixel" if changed else "")
                    figures = found.setdefault(row, {choice: [] for choice in CHOICES})
                    common = {"background": background, "settings": {**settings, **changed}, "device": device}
                    images = [draw(asset, msb.Camera(**camera), **common, **o) for o in CHOICES.values()]
                    for choice, image in zip(CHOICES, images, strict=True):
                        figures[choice].append(psnr(image, official, stable))
                    if name in SHOWN and not changed:
                        strips.append(np.concatenate([official, *images], axis=1))
    return found, strips


def captures(device: str | None) -> dict[Row, Figures]:
    """Return the figures of the benchmark's synthetic models, whose faces are in random order."""
    found = {}
    for method in BLENDED:
        asset, camera = capture(method, CAPTURE), capture_camera(620, 411)
        official = draw(asset, camera, device=device, background="black")
        found[Row(method, f"synthetic capture of {CAPTURE:,} faces, 620 x 411")] = {
            choice: [psnr(draw(asset, camera, device=device, background="black", **options), official)]
            for choice, options in CHOICES.items()
        }
    return found


def cell(values: list[float]) -> str:
    """Return the median and the range of PSNR over views, in whole dB."""
    if min(values) >= EQUAL:
        return "equal"
    middle, low, high = (
        "equal" if value >= EQUAL else f"{value:.0f}" for value in (median(values), min(values), max(values))
    )
    return low if low == high else f"{middle} ({low} to {high})"


def table(figures: dict[str, Figures], first: str) -> str:
    """Return a Markdown table with a row for each key of `figures`."""
    lines = [f"| {first} | " + " | ".join(CHOICES) + " |", "|---" * (len(CHOICES) + 1) + "|"]
    for row, by_choice in figures.items():
        lines.append(f"| {row} | " + " | ".join(cell(by_choice[choice]) for choice in CHOICES) + " |")
    return "\n".join(lines)


def by_method(found: dict[Row, Figures]) -> dict[str, Figures]:
    """Return the figures of all scenes of a method together, with its own settings."""
    rows: dict[str, Figures] = {title: {choice: [] for choice in CHOICES} for title in TITLES.values()}
    for row, figures in found.items():
        for choice in CHOICES if not row.note else ():
            rows[TITLES[row.method]][choice] += figures[choice]
    return rows


def save(strips: list[NDArray[np.float32]], path: Path) -> None:
    """Write the strips below each other: official, then every choice."""
    from PIL import Image

    rows = []
    for strip in strips:
        height = round(strip.shape[0] * WIDTH / strip.shape[1])
        pixels = np.floor(np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)
        rows.append(np.asarray(Image.fromarray(pixels).resize((WIDTH, height), Image.Resampling.LANCZOS)))
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def causes(folder: Path) -> str:
    """Write an image of each cause on the stub models into `folder`, and return their table."""
    cameras = [camera.resized(*SIZE) for camera in msb.read_cameras(STUBS / "scenes/mipnerf360/pebble")[:4]]
    found = {method: why(msb.open(STUBS / "models" / "walled" / method), cameras) for method in OFFICIAL}
    head = ["cause", *(TITLES[method] for method in found)]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for row in zip(*found.values(), strict=True):
        lines.append(f"| {row[0].title} | " + " | ".join(_decibels(one.db) for one in row) + " |")
        worst = min((one for one in row if one.db is not None), key=lambda one: one.db or 0.0)
        if worst.without is not None and worst.with_it is not None:
            gap = np.ones((len(worst.without), GAP, 3), np.float32)
            save(
                [np.concatenate([worst.without, gap, worst.with_it], axis=1)],
                folder / f"why_{worst.name}.png",
            )
    totals = (_decibels(one.total.db) for one in found.values())
    lines.append(f"| **All of it at once** | {' | '.join(totals)} |")
    assert len(lines) == len(CAUSES) + 3
    return "\n".join(lines)


def _decibels(db: float | None) -> str:
    if db is None:
        return "--"
    return "equal" if db >= EQUAL else f"{db:.1f}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path, default=[ROOT / "tests" / "golden"])
    parser.add_argument("--device")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--causes", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.causes is not None:
        sys.stdout.write(causes(arguments.causes) + "\n")
        return
    found, strips = golden(arguments.folders, arguments.device)
    sys.stdout.write(table(by_method(found), "PSNR in dB, median (least to most)") + "\n\n")
    everything = found | captures(arguments.device)
    ordered = sorted(everything, key=lambda row: TRAINED.index(row.method))
    rows = {str(row): everything[row] for row in ordered}
    sys.stdout.write(table(rows, "scene") + "\n")
    if arguments.picture is not None:
        save(strips, arguments.picture)


if __name__ == "__main__":
    main()
