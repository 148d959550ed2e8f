"""Measure bakes of realistic size: millions of triangles in a garden with 50 views.

    python -m benchmarks.bake_scale --faces 1000000 3000000 --geometry kept fitted

The table has a row for each bake: triangles, seconds, CPU seconds and peak memory. It also has the PSNR of
the standard-tier mesh and of the bake against native rendering, on held-out views. Each stage has a row with
its time and memory. The garden is synthetic: a lawn with slabs, a table with a vase, bushes and a sky. It is
covered with soft triangles of `--method`. They have spherical harmonics of degree 3 and colours in a fine
pattern. Each bake runs in a separate process. `--options` passes further options of `msb.bake` as JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msb
from benchmarks.dedicated_scenes import BLENDED, SIZES, asset_of, is_connected
from benchmarks.measure import keep, machine, peak, processor_seconds
from msb.asset.sh import SH_C0

Reals = NDArray[np.float64]

SOUPS = tuple(name for name in BLENDED if not is_connected(name))
PARTS = {"lawn": 0.25, "table": 0.12, "legs": 0.03, "vase": 0.1, "bushes": 0.35, "sky": 0.15}
"""The share of the faces of each part of the garden.

Most faces are near the centre of the camera path, as in trained models.
"""
_COVER = 6.0
"""Area of all faces, divided by the area that they cover. It is above 1, because soft edges cover less."""
_SOFT = -1.0
"""Softness of the edges of faces.

The edges are between a linear fall-off and a hard edge, as at the end of a training.
"""
_LAWN, _SKY = 10.0, 14.0
RINGS = ((2.6, 1.3), (3.2, 2.0), (2.2, 2.6))
"""Distances of the cameras from the centre of the table, and their heights.

Successive cameras use them in turn.
"""
_COLUMNS = (
    *("faces", "views", "geometry", "plain, 1", "baked, 1", "baked, 16", "triangles"),
    *("s", "processor s", "peak GB"),
)
HEADER = f"| {' | '.join(_COLUMNS)} |\n{'|---' * len(_COLUMNS)}|"


def garden(faces: int, seed: int = 0) -> dict[str, Any]:
    """Return the garden in the format of `benchmarks.dedicated_scenes.soup`. +z is up."""
    random = np.random.default_rng(seed)
    made = [_part(name, round(share * faces), random) for name, share in PARTS.items()]
    places, normals, areas, colors = (np.concatenate(each) for each in zip(*made, strict=True))
    count = len(places)
    normals = normals + 0.1 * random.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.cross(normals, random.standard_normal((count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    # An equilateral triangle with circumradius 1 has an area of 1.3.
    radius = np.sqrt(_COVER * areas / 1.3) * np.exp(0.4 * random.standard_normal(count) - 0.16)
    angles = 2 * np.pi * (np.arange(3) / 3 + 0.08 * random.standard_normal((count, 3)))
    corners = np.cos(angles)[..., None] * across[:, None] + np.sin(angles)[..., None] * along[:, None]
    positions = places[:, None] + radius[:, None, None] * corners
    opacity = np.clip(random.beta(2.5, 0.5, count), 1e-3, 1 - 1e-4)
    f_rest = random.normal(0, 0.01, (count, 45))
    f_rest[:, :9] += 0.04 * np.repeat(normals, 3, axis=1)  # a sheen
    return {
        "positions": positions.reshape(-1, 3).astype(np.float32),
        "indices": np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        "opacity": np.log(opacity / (1 - opacity)).astype(np.float32),
        "f_dc": ((colors - 0.5) / SH_C0).astype(np.float32),
        "f_rest": f_rest.astype(np.float32),
    }


def _part(name: str, count: int, random: np.random.Generator) -> tuple[Reals, Reals, Reals, Reals]:
    """Return face positions and normals on a part (n, 3), the area of each face (n,), and colours (n, 3)."""
    u, v = random.random((2, count))
    turn = 2 * np.pi * u
    round_ = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    if name == "lawn":  # faces get smaller towards the table
        far = 0.2 + (_LAWN - 0.2) * v
        places = far[:, None] * round_ + 0.03 * np.sin(3 * far)[:, None] * up
        slab = (np.sin(4 * places[:, 0]) * np.sin(4 * places[:, 1]) > 0)[:, None]
        colors = np.where(slab, (0.6, 0.55, 0.5), (0.3, 0.5, 0.2)) + _grain(places, 9)
        return places, np.tile(up, (count, 1)), 2 * np.pi * _LAWN * far / count, colors
    if name == "table":
        far = np.sqrt(v)
        places = far[:, None] * round_ + 0.8 * up
        rings = 0.12 * np.sin(40 * far + 3 * np.sin(2 * turn))[:, None]
        colors = np.array([0.55, 0.38, 0.25]) + rings + _grain(places, 30)
        return places, np.tile(up, (count, 1)), np.full(count, np.pi / count), colors
    if name in ("legs", "vase"):
        low, high = (0.0, 0.8) if name == "legs" else (0.8, 1.5)
        height = low + (high - low) * v
        far = np.full(count, 0.12) if name == "legs" else 0.16 + 0.08 * np.sin(9 * height)
        places = far[:, None] * round_ + height[:, None] * up
        bands = 0.2 * np.sign(np.sin(50 * height) * np.sin(8 * turn))[:, None] * np.array([1, -0.5, -1])
        colors = np.array([0.5, 0.4, 0.45]) + bands + _grain(places, 30)
        return places, round_, 2 * np.pi * far * (high - low) / count, colors
    dome = np.cos(np.arcsin(2 * v - 1))[:, None] * round_ + (2 * v - 1)[:, None] * up
    if name == "sky":
        dome[:, 2] = np.abs(dome[:, 2])
        hedge = (dome[:, 2] < 0.12 + 0.03 * np.sin(12 * turn))[:, None]
        colors = np.where(hedge, (0.2, 0.35, 0.15), (0.5, 0.65, 0.85)) + _grain(_SKY * dome, 2)
        return _SKY * dome, -dome, np.full(count, 2 * np.pi * _SKY**2 / count), colors
    number = random.integers(0, 24, count)
    radius = 0.4 + 0.5 * np.modf(0.618 * number)[0]
    where = number * 2 * np.pi / 24
    middle = (4.5 + 1.5 * np.sin(5.0 * number))[:, None] * np.stack([np.cos(where), np.sin(where)], axis=1)
    bumpy = radius * (1 + 0.15 * np.sin(6 * dome[:, 0]) * np.sin(7 * dome[:, 1] + 5 * dome[:, 2]))
    places = bumpy[:, None] * dome
    places[:, :2] += middle
    places[:, 2] += 0.7 * radius
    leaves = dome + 0.7 * random.standard_normal((count, 3))
    colors = np.array([0.25, 0.4, 0.15]) + 0.1 * np.sin(number)[:, None] + _grain(places, 25)
    return places, leaves, 24 * 4 * np.pi * radius**2 / count, colors


def _grain(places: Reals, frequency: float) -> Reals:
    """Return a pattern (n, 1) of two scales. The finer scale matches the face size of a million faces."""
    x, y, z = frequency * places.T
    coarse, fine = np.sin(x + 1) * np.sin(y) + np.sin(z + y), np.sin(5 * x) * np.sin(5 * y + 5 * z)
    pattern: Reals = 0.06 * coarse[:, None] + 0.04 * fine[:, None]
    return pattern


def cameras(count: int, width: int, height: int) -> list[msb.Camera]:
    """Return cameras on rings around the table."""
    turns = np.arange(count) * 2 * np.pi * len(RINGS) / count
    return [
        msb.Camera.look_at(
            (far * np.cos(turn), far * np.sin(turn), high),
            (0, 0, 0.8),
            up=(0, 0, 1),
            width=width,
            height=height,
            fov_y=0.7,
            name=f"{number:05d}",
        )
        for number, (turn, (far, high)) in enumerate(zip(turns, RINGS * (count // 3 + 1), strict=False))
    ]


class Stages:
    """A progress callback of a bake. It measures seconds, CPU seconds and peak memory of each stage."""

    def __init__(self) -> None:
        self.found: dict[str, list[float]] = {}
        self._stage, self._began = "views", (time.perf_counter(), processor_seconds())

    def __call__(self, stage: str, _done: int = 0, _total: int = 0) -> None:
        """Add the time since the previous call to the stage that the previous call named.

        Every stage also reports its start.
        """
        now = time.perf_counter(), processor_seconds()
        row = self.found.setdefault(self._stage, [0.0, 0.0, 0.0])
        for k in range(2):
            row[k] += now[k] - self._began[k]
        row[2] = peak()
        if stage != self._stage:
            print(_stage_row(self._stage, row), file=sys.stderr, flush=True)
        self._stage, self._began = stage, now


def _stage_row(stage: str, took: list[float]) -> str:
    return f"    {stage:<24}{took[0]:>8.1f}{took[1]:>8.1f}{took[2] / 1e9:>8.2f}"


def bake(model: Path, views: int, size: list[int], options: dict[str, Any]) -> dict[str, Any]:
    """Bake in this process. Return the report, and the time and memory of each stage."""
    stages = Stages()
    began = time.perf_counter(), processor_seconds()
    baked = msb.bake(model, cameras=cameras(views, *size), progress=stages, **options)
    stages("saving")
    report = baked.save(model.with_suffix(".glb"), overwrite=True).to_dict()
    stages("")
    took = {"seconds": time.perf_counter() - began[0], "processor_seconds": processor_seconds() - began[1]}
    del report["path"], report["output"]
    return {**report, **took, "peak": peak(), "stages": stages.found}


def show(row: dict[str, Any]) -> None:
    """Print the row of a bake, and its stages."""
    own = row["psnr"]["native"]
    cells = [f"{row['model_faces']:,}", str(row["of_views"]), row["geometry"]]
    cells += [f"{own[key]:.2f}" for key in ("before", "after", "after_16")] + [f"{row['faces']:,}"]
    cells += [f"{row['seconds']:.0f}", f"{row['processor_seconds']:.0f}", f"{row['peak'] / 1e9:.2f}"]
    print(f"| {' | '.join(cells)} |", flush=True)
    print(*(_stage_row(stage, took) for stage, took in row["stages"].items()), sep="\n", flush=True)
    print("".join(f"    {note}\n" for note in row["notes"]), end="", flush=True)


def main() -> None:
    """Create the models, bake each in a separate process, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--faces", type=int, nargs="+", default=[1_000_000, 3_000_000])
    add("--geometry", nargs="+", default=["kept", "fitted"])
    add("--views", type=int, nargs="+", default=[50])
    add("--size", type=int, nargs=2, default=SIZES[1], metavar=("WIDTH", "HEIGHT"))
    add("--method", choices=SOUPS, default="triangle_splatting")
    add("--options", type=json.loads, default={}, help='such as {"seconds": 0}')
    add("--folder", type=Path, help="keep the models here; default: a temporary folder")
    add("--json", type=Path, help="also write the figures to this file")
    add("--worker", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        print(json.dumps(bake(Path(given.worker), given.views[0], given.size, given.options)))
        return
    facts = machine("numpy", "scipy", "pyopencl", "pocl-binary-distribution")
    print(", ".join(f"{key} {value}" for key, value in facts.items()), time.strftime("%Y-%m-%d"), sep="\n")
    print(HEADER, flush=True)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        for faces in given.faces:
            model = (given.folder or Path(name)) / f"{given.method}-{faces}.triasset"
            if not model.exists():
                msb.save(asset_of(given.method, garden(faces), _SOFT), model)
            for views in given.views:
                for geometry in given.geometry:
                    options = json.dumps({"geometry": geometry, **given.options})
                    command = [sys.executable, "-m", "benchmarks.bake_scale", "--worker", str(model)]
                    command += ["--views", str(views), "--size", *map(str, given.size), "--options", options]
                    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
                    rows.append({**json.loads(done.stdout.splitlines()[-1]), "of_views": views})
                    show(rows[-1])
                    keep({"machine": facts, "size": given.size, "rows": rows}, given.json)


if __name__ == "__main__":
    main()
