"""Measure the loss of image quality by the draw orders and samplings of engines: `python -m
tools.figures.losses`.

Every golden view is drawn on the dedicated tier with each order and sampling. The golden views are in
tests/golden, or in the folders in the arguments. The result is compared with the official image, at pixels
that do not depend on rounding. The synthetic captures of benchmarks/dedicated.py have no official image; they
are compared with our rendering in the official mode. The program prints a table by method and a table by
scene. --picture FILE.png also writes an image with a view of each method.

`python -m tools.figures.losses --causes docs/images` measures the causes of `msb why` on the stub models
instead. It prints a table of the causes, and writes an image of each cause with the method that loses most.
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
from msb.why.total import TITLE
from tests.golden.views import METHODS as GOLDEN
from tests.golden.views import scenes, views

ROOT = Path(__file__).parents[2]
OFFICIAL = tuple(name for name in TRAINED if name in GOLDEN)
"""The methods with golden scenes, and the methods with demo models."""
TITLES = {name: METHODS[name].title for name in TRAINED}
CHOICES: dict[str, dict[str, str]] = {
    "`order=global`": {"order": "global"},
    "`order=none`": {"order": "none"},
    "`sampling=engine`": {"sampling": "engine"},
    "both: `engine`, `none`": {"order": "none", "sampling": "engine"},
}
SINGLE = {"supersample": 1}
"""Settings of an additional measurement of MeshSplatting: one sample per pixel, as in an engine."""
CAPTURE = 100_000
"""Number of faces of the synthetic captures."""
PICTURED = ("orb_diffuse/0", "torus_sh0_white/0", "bumpy_sphere_sh3/0", "soup_l1_black_noview/0")
"""The view of each method that --picture shows."""

STUBS = ROOT / "data_stubs"
SIZE = 448, 336
"""Width and height of the views for --causes, in pixels."""
GAP = 8
"""Width of the gap between the two halves of an image of a cause, in pixels."""
WIDTH = 900
"""Width of the written images, in pixels."""

Figures = dict[str, list[float]]
"""The PSNR of the views in dB for each choice of order and sampling."""


class Row(NamedTuple):
    """A row of the table by scene. `note` names a changed setting."""

    method: str
    scene: str
    note: str = ""

    def __str__(self) -> str:
        return f"{TITLES[self.method]}, {self.scene}{self.note}"


def draw(asset: msb.Asset, camera: msb.Camera, **options: Any) -> NDArray[np.float32]:
    """Return the image of the dedicated tier."""
    return msb.render(asset, camera, tier="dedicated", outputs=(), **options).image


def measure_golden_views(roots: list[Path], device: str | None) -> tuple[dict[Row, Figures], list[Any]]:
    """Return the figures of each golden scene, and the strips of images for --picture."""
    results: dict[Row, Figures] = {}
    strips = []
    for method in OFFICIAL:
        for scene in (folder for root in roots for folder in scenes(root, method)):
            asset = msb.export(scene / "checkpoint")
            for name, camera, background, settings, official, stable in views(scene, method):
                for changed in ({}, SINGLE) if "supersample" in METHODS[method].settings else ({},):
                    row = Row(method, f"`{scene.name}`", ", one sample a pixel" if changed else "")
                    figures = results.setdefault(row, {choice: [] for choice in CHOICES})
                    common = {"background": background, "settings": {**settings, **changed}, "device": device}
                    images = [draw(asset, msb.Camera(**camera), **common, **o) for o in CHOICES.values()]
                    for choice, image in zip(CHOICES, images, strict=True):
                        figures[choice].append(psnr(image, official, stable))
                    if name in PICTURED and not changed:
                        strips.append(np.concatenate([official, *images], axis=1))
    return results, strips


def measure_captures(device: str | None) -> dict[Row, Figures]:
    """Return the figures of the synthetic captures, whose faces are in random order."""
    results = {}
    for method in BLENDED:
        asset, camera = capture(method, CAPTURE), capture_camera(620, 411)
        official = draw(asset, camera, device=device, background="black")
        results[Row(method, f"synthetic capture of {CAPTURE:,} faces, 620 x 411")] = {
            choice: [psnr(draw(asset, camera, device=device, background="black", **options), official)]
            for choice, options in CHOICES.items()
        }
    return results


def format_range(values: list[float]) -> str:
    """Return the median and the range of the PSNR values, in whole dB, as text."""
    if min(values) >= EQUAL:
        return "equal"
    middle, low, high = (
        "equal" if value >= EQUAL else f"{value:.0f}" for value in (median(values), min(values), max(values))
    )
    return low if low == high else f"{middle} ({low} to {high})"


def format_table(figures: dict[str, Figures], first: str) -> str:
    """Return a Markdown table with a row for each key of `figures`."""
    lines = [f"| {first} | " + " | ".join(CHOICES) + " |", "|---" * (len(CHOICES) + 1) + "|"]
    for row, by_choice in figures.items():
        lines.append(f"| {row} | " + " | ".join(format_range(by_choice[choice]) for choice in CHOICES) + " |")
    return "\n".join(lines)


def group_by_method(results: dict[Row, Figures]) -> dict[str, Figures]:
    """Return the figures of each method over all its scenes, without changed settings."""
    rows: dict[str, Figures] = {title: {choice: [] for choice in CHOICES} for title in TITLES.values()}
    for row, figures in results.items():
        for choice in CHOICES if not row.note else ():
            rows[TITLES[row.method]][choice] += figures[choice]
    return rows


def write_strips(strips: list[NDArray[np.float32]], path: Path) -> None:
    """Write an image with all strips, one below the other."""
    from PIL import Image

    rows = []
    for strip in strips:
        height = round(strip.shape[0] * WIDTH / strip.shape[1])
        pixels = np.floor(np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)
        rows.append(np.asarray(Image.fromarray(pixels).resize((WIDTH, height), Image.Resampling.LANCZOS)))
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def measure_causes(folder: Path) -> str:
    """Measure all causes on the stub models, write an image of each into `folder`, and return their table."""
    cameras = [camera.resized(*SIZE) for camera in msb.read_cameras(STUBS / "scenes/mipnerf360/pebble")[:4]]
    results = {method: why(msb.open(STUBS / "models" / "walled" / method), cameras) for method in OFFICIAL}
    head = ["cause", *(TITLES[method] for method in results)]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for row in zip(*results.values(), strict=True):
        lines.append(f"| {row[0].title} | " + " | ".join(_decibels(cause.db) for cause in row) + " |")
        worst = min((cause for cause in row if cause.db is not None), key=lambda cause: cause.db or 0.0)
        if worst.without is not None and worst.with_it is not None:
            gap = np.ones((len(worst.without), GAP, 3), np.float32)
            write_strips(
                [np.concatenate([worst.without, gap, worst.with_it], axis=1)],
                folder / f"why_{worst.name}.png",
            )
    totals = (_decibels(losses.total.db) for losses in results.values())
    lines.append(f"| **{TITLE}** | {' | '.join(totals)} |")
    assert len(lines) == len(CAUSES) + 3
    return "\n".join(lines)


def _decibels(db: float | None) -> str:
    if db is None:
        return "--"
    return "equal" if db >= EQUAL else f"{db:.1f}"


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path, default=[ROOT / "tests" / "golden"])
    parser.add_argument("--device")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--causes", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.causes is not None:
        sys.stdout.write(measure_causes(arguments.causes) + "\n")
        return
    results, strips = measure_golden_views(arguments.folders, arguments.device)
    sys.stdout.write(format_table(group_by_method(results), "PSNR in dB, median (least to most)") + "\n\n")
    everything = results | measure_captures(arguments.device)
    ordered = sorted(everything, key=lambda row: TRAINED.index(row.method))
    rows = {str(row): everything[row] for row in ordered}
    sys.stdout.write(format_table(rows, "scene") + "\n")
    if arguments.picture is not None:
        write_strips(strips, arguments.picture)


if __name__ == "__main__":
    main()
