"""Run the whole protocol on a real capture: `python -m benchmarks.garden SCENE`.

`--models DIR` is a folder with a trained model of each method, for example out/trainings/garden as written by
`python -m data_stubs.trainings --garden SCENE`. docs/trained.md shows the results, and `--picture` its image.
The models are also drawn as engines would draw them (`VARIANTS`, `ENGINES`). The tasks of a trial run on the
models and on their repairs.

Without `--models`, a model of each method is created from the capture's SfM points: a small triangle at each
point, oriented by its neighbours, in the colour of the photographs. The images of such a model are sparse and
spotty. They still show export, rendering, comparison, timing and audit of a capture in the official layout,
with their time and memory.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from data_stubs.made_models import TRAINED, write_models
from data_stubs.surface import Surface
from msb.bench.protocol import parse_protocol
from msb.bench.run import Report, run_protocol
from msb.scenes import read_points

NEIGHBOURS = 8
SIZE = 1.6
"""Circumradius of a triangle, relative to the mean distance to the three nearest neighbours."""
GAP = 4
"""Gap between the images of the picture in pixels."""
COLORS = 256
"""Number of colours in the picture's palette. The palette reduces the file to a third of its size."""
LARGEST = 0.98
"""Sizes are limited to this quantile. Otherwise triangles at distant points would cover the sky."""

VARIANTS = {
    "engine": {"order": "global", "sampling": "engine"},
    "unsorted": {"order": "none", "sampling": "engine"},
    "hardware": {"renderer": "wgpu"},
}
"""The setting of each label that differs from the dedicated tier."""
ENGINES = ["wgpu", "threejs"]
"""Other renderers of the standard tier."""
PICTURED = ("dedicated", "standard")
"""Conditions of the picture's rows."""


def surface_of(scene: Path) -> Surface:
    """Return a triangle for each SfM point of the COLMAP model below `scene`."""
    points, colors = read_points(scene)
    distance, near = cKDTree(points).query(points, k=NEIGHBOURS + 1, workers=-1)
    # The normal is the direction of least variance of the neighbours.
    spread = points[near] - points[near].mean(axis=1, keepdims=True)
    axes = np.linalg.svd(spread, full_matrices=False)[2]
    size = SIZE * distance[:, 1:4].mean(axis=1)
    size = np.minimum(size, np.quantile(size, LARGEST))[:, None]
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, len(points))
    corners = np.stack(
        [
            points + size * (np.cos(turn)[:, None] * axes[:, 0] + np.sin(turn)[:, None] * axes[:, 1])
            for turn in (angles + 2 * np.pi * third / 3 for third in range(3))
        ],
        axis=1,
    )
    return Surface(
        vertices=corners.reshape(-1, 3),
        faces=np.arange(3 * len(points)).reshape(-1, 3),
        color=(colors / 255.0).repeat(3, axis=0),
        gloss=np.zeros(3 * len(points)),
        light=np.array([0.0, -1.0, 0.0]),
    )


def protocol_text(
    scene: Path,
    models: str,
    image_folder: str | None,
    resolution: int | None,
    *,
    reference: bool,
    all_of_it: bool,
) -> str:
    """Return the protocol for evaluating the models in a folder on the scene."""
    lines = [f"engines = {json.dumps(ENGINES)}", "[trial]", "compare = true"] if all_of_it else []
    for label, options in VARIANTS.items() if all_of_it else ():
        lines += [
            "[[variants]]",
            f'label = "{label}"',
            *(f'{name} = "{value}"' for name, value in options.items()),
        ]
    lines += [
        "[[datasets]]",
        'name = "mipnerf360"',
        f"path = {json.dumps(str(scene.parent.resolve()))}",
        f"scenes = [{json.dumps(scene.name)}]",
        *([f"image_folder = {json.dumps(image_folder)}"] if image_folder else []),
        *([f"resolution = {resolution}"] if resolution else []),
    ]
    for method in TRAINED:
        lines += ["[[methods]]", f'name = "{method}"', f"model = {json.dumps(models + '/{method}')}"]
        lines += ['non_engine = "reference"'] if reference else []
    return "\n".join(lines) + "\n"


def montage(results: Path, scene: str) -> Image.Image:
    """Return a grid of images of the first test view, with a column per method and a row per entry of
    `PICTURED`.

    A missing image is white.
    """
    found = {}
    for row, condition in enumerate(PICTURED):
        for column, method in enumerate(TRAINED):
            images = results / "cells" / "mipnerf360" / scene / method / condition / "images"
            if images.is_dir():
                found[column, row] = Image.open(sorted(images.glob("*.png"))[0]).convert("RGB")
    width, height = next(iter(found.values())).size
    size = (len(TRAINED) * (width + GAP) - GAP, len(PICTURED) * (height + GAP) - GAP)
    picture = Image.new("RGB", size, "white")
    for (column, row), image in found.items():
        picture.paste(image, (column * (width + GAP), row * (height + GAP)))
    return picture


def show(report: Report) -> None:
    """Print the measurements."""
    for row in report.rows:
        result = row.result
        quality = result and result.quality
        timing = result and result.timing
        cells = [row.planned.cell.method, row.planned.cell.condition_name]
        psnr = quality and quality.values["psnr"]
        cells.append("--" if psnr is None else f"{psnr:.2f} dB")
        cells.append("--" if not timing else f"{timing.fps:.1f} FPS, P50 {timing.p50_ms:.1f} ms")
        cells.append(f"{row.seconds:.1f} s")
        reason = row.reasons.get("cell") or row.planned.reason
        print("  ".join(f"{cell:20}" for cell in cells), "" if reason is None else reason.code)
    print(f"{len(report.rows)} cells in {report.seconds:.0f} s")


def main() -> int:
    """Create the models, write the protocol, and run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="folder of a capture in Mip-NeRF 360's layout")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/garden"))
    parser.add_argument("--models", type=Path, help="trained models, a folder for each method")
    parser.add_argument("--resolution", type=int, help="1, 2, 4 or 8 divide the photographs' size")
    parser.add_argument("--image-folder", help="folder of the photographs; default: images_4 or images_2")
    parser.add_argument("--reference", action="store_true", help="use our slow NumPy renderer as Non-Engine")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help="write an image of a test view by every method"
    )
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.models is None:
        start = time.perf_counter()
        surface = surface_of(given.scene)
        write_models(given.out / "models", surface, white=False, layout="colmap")
        print(f"{len(surface.faces):,} triangles of each method in {time.perf_counter() - start:.0f} s")
    text = protocol_text(
        given.scene,
        "models" if given.models is None else str(given.models.resolve()),
        given.image_folder,
        given.resolution,
        reference=given.reference,
        all_of_it=given.models is not None,
    )
    (given.out / "protocol.toml").write_text(text)
    protocol = parse_protocol(text.encode(), given.out / "protocol.toml")
    report = run_protocol(protocol, jobs=given.jobs)
    show(report)
    if given.picture:
        picture = montage(protocol.results, given.scene.name)
        picture.quantize(COLORS, dither=Image.Dither.NONE).save(given.picture, optimize=True)
    return report.exit_status


if __name__ == "__main__":
    sys.exit(main())
