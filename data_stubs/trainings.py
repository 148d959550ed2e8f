"""Train the models in `data_stubs/models`: `python -m data_stubs.trainings` takes an hour on two cores.

`--garden SCENE` trains the four models of docs/trained.md instead, on Mip-NeRF 360's garden at 1/16 of its
size. `--jobs` trainings run in parallel, each on one core; `--only` selects some. Results are in `--output`;
models of the stub scenes are also copied to `data_stubs/models`. An interrupted training continues. `--table`
prints a table of finished trainings without training.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from msb.registry import METHODS

HERE = Path(__file__).parent
_LEFT_OUT = "training.npz"
"""The file of the training state, which is many times larger than the model."""

STUBS = {
    "walled": ("mipnerf360/pebble", "--image-folder", "images_4"),
    "pebble": ("nerf_synthetic/pebble", "--points", "data_stubs/scenes/dtu/scan1"),
}
"""The arguments of each kind of scene: pebbles in front of a wall, or one pebble (also for DTU)."""
_STUB_OPTIONS = {
    "walled/two_dts": "--faces 2500 --sh-degree 1 --iterations 3500",
    "walled/triangle_splatting": "--faces 2500 --sh-degree 1 --iterations 4000",
    "walled/mesh_splatting": "--faces 8000 --sh-degree 1 --iterations 3000",
    "walled/diffsoup": "--faces 1400 --level 1 --iterations 2000",
    "pebble/two_dts": "--faces 2500 --sh-degree 1 --iterations 3500",
    "pebble/triangle_splatting": "--faces 2500 --sh-degree 1 --iterations 4000",
    "pebble/mesh_splatting": "--faces 8000 --sh-degree 1 --iterations 3000",
    "pebble/diffsoup": "--faces 1400 --level 1 --iterations 2000",
    "pebble/three_dgs": "--faces 3000 --sh-degree 1 --iterations 3000",
}
_GARDEN_OPTIONS = {
    "two_dts": "--faces 20000 --sh-degree 2 --iterations 4500",
    "triangle_splatting": "--faces 20000 --sh-degree 2 --iterations 8000",
    "mesh_splatting": "--faces 30000 --sh-degree 2 --iterations 4000",
    "diffsoup": "--faces 12000 --level 2 --iterations 4500",
}
_GARDEN = ("--image-folder", "images_8", "--resolution", "2")


def trainings(garden: Path | None) -> dict[str, list[str]]:
    """Return the arguments of `data_stubs.training` for each training, by name."""
    found = {}
    if garden is not None:
        for method, options in _GARDEN_OPTIONS.items():
            found[method] = ["--scene", str(garden), *_GARDEN, "--method", method, *options.split()]
        return found
    for name, options in _STUB_OPTIONS.items():
        world, method = name.split("/")
        scene, *more = STUBS[world]
        found[name] = ["--scene", f"data_stubs/scenes/{scene}", *more, "--method", method, *options.split()]
    return found


def train(output: Path, name: str, arguments: list[str]) -> int:
    """Train one model, write its progress to `output`/`name`.log, and return the exit status."""
    folder = output / name
    folder.mkdir(parents=True, exist_ok=True)
    again = ["--resume"] if (folder / _LEFT_OUT).exists() else []
    command = [sys.executable, "-m", "data_stubs.training", *arguments, "--output", str(folder), *again]
    one_core = {**os.environ, "OMP_NUM_THREADS": "1"}
    with (output / f"{name}.log").open("a") as log:
        status = subprocess.run(command, stdout=log, stderr=log, env=one_core, check=False, cwd=HERE.parent)
    print(f"{name}: exit status {status.returncode}", flush=True)
    return status.returncode


def ship(output: Path, name: str) -> None:
    """Copy the official files and the log of a finished training to `data_stubs/models`."""
    target = HERE / "models" / name
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(output / name, target, ignore=shutil.ignore_patterns(_LEFT_OUT))


def table(folders: dict[str, Path]) -> str:
    """Return a Markdown table of trainings; `folders` holds the folder with `training.json` of each, by name.

    The last columns are the PSNR (dB) of the test views after 10 % to 100 % of the iterations.
    """
    shares = (0.1, 0.25, 0.5, 0.75, 1.0)
    titles = ["method", "scene", "triangles", "iterations", "minutes"]
    titles += [f"{share:.0%}" for share in shares]
    lines = [f"| {' | '.join(titles)} |".replace("%", "&nbsp;%"), "|" + "---|" * len(titles)]
    for name, folder in folders.items():
        about: dict[str, Any] = json.loads((folder / "training.json").read_text())
        course = [
            min(about["psnr"], key=lambda entry: abs(entry["iteration"] - share * about["iterations"]))[
                "psnr"
            ]
            for share in shares
        ]
        scene = about["command"]["scene"] + (f" ({name.split('/')[0]})" if "/" in name else "")
        lines.append(
            f"| {METHODS[about['method']].title} | {scene} | {about['faces']:,} | {about['iterations']:,} "
            f"| {about['seconds'] / 60:.0f} | {' | '.join(f'{value:.1f}' for value in course)} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Run all trainings; return the highest exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--garden", type=Path, metavar="SCENE")
    parser.add_argument("--output", type=Path, default=Path("out/trainings"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="+", metavar="NAME")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    chosen = trainings(options.garden.resolve() if options.garden else None)
    chosen = {name: value for name, value in chosen.items() if not options.only or name in options.only}
    output: Path = options.output.resolve() / ("garden" if options.garden else "stubs")
    if not options.table:
        with ThreadPoolExecutor(options.jobs) as pool:
            statuses = list(pool.map(partial(train, output), chosen, chosen.values()))
        if any(statuses):
            return max(statuses)
        if options.garden is None:
            for name in chosen:
                ship(output, name)
    print(table({name: output / name for name in chosen}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
