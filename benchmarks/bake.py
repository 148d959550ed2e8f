"""What trained models lose as plain assets, and what a bake gives back.

    python -m benchmarks.bake [MODEL SCENE ...]

prints a row for each model and geometry: dB to held-out photographs of the model's own look, of its plain
mesh, and of what was baked, with 1 and 16 samples a pixel; triangles, bytes, seconds, and the peak of memory.
Each bake runs in a process of its own, and twice with `--twice`, which must give the same bytes. Without
arguments the models are those of `msb demo-data`; `--image-folder` and `--resolution` are of the scene.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.measure import keep, machine

MODELS = Path("data_stubs/models")
SCENES = {
    "pebble": Path("data_stubs/scenes/nerf_synthetic/pebble"),
    "walled": Path("data_stubs/scenes/mipnerf360/pebble"),
}
METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")
GEOMETRIES = ("kept", "fitted")
_COLUMNS = (
    *("model", "geometry", "own look", "plain, 1 sample", "baked, 1", "baked, 16"),
    *("triangles", "texture", "MB", "s", "peak MB", "verdict"),
)
HEADER = f"| {' | '.join(_COLUMNS)} |\n{'|---' * len(_COLUMNS)}|"
_ONE = """
import json, resource, sys, time
import msb
from msb.scenes.datasets import dataset_of, scene_at
from pathlib import Path
model, scene, out, options = sys.argv[1], Path(sys.argv[2]), sys.argv[3], json.loads(sys.argv[4])
asset = msb.open(model)
read = scene_at(scene, dataset_of(scene), asset.manifest.method, **options.pop("scene")).read()
began = time.perf_counter()
report = msb.bake(asset, scene=read, **options).save(out)
seconds = time.perf_counter() - began
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
print(json.dumps({**report.to_dict(), "seconds": seconds, "peak_mb": peak}))
"""


def baked(model: Path, scene: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Return the report of one bake, with its peak of memory and the hash of its GLB."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "baked.glb")
        command = [sys.executable, "-c", _ONE, str(model), str(scene), str(out), json.dumps(options)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found | {"sha256": hashlib.sha256(out.read_bytes()).hexdigest()}


def row(name: str, report: dict[str, Any]) -> str:
    """Return the row of Markdown of one bake."""
    psnr = report["psnr"]["photographs"] or {"dedicated": None, **report["psnr"]["own"]}
    decibels = [
        "" if psnr[key] is None else f"{psnr[key]:.2f}"
        for key in ("dedicated", "before", "after", "after_16")
    ]
    texture = "" if report["texture"] is None else str(report["texture"][0])
    verdict = report["verdict_after"]["level"]
    facts = [f"{report['faces']:,}", texture, f"{report['bytes'] / 1e6:.2f}", f"{report['seconds']:.0f}"]
    return f"| {' | '.join([name, report['geometry'], *decibels, *facts, str(report['peak_mb']), verdict])} |"


def main() -> int:
    """Bake and print; return 1 if a second bake gave other bytes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("pairs", nargs="*", type=Path, metavar="MODEL SCENE", help="models and their scenes, by turns")
    add("--geometry", nargs="+", default=GEOMETRIES)
    add("--only", nargs="+", metavar="NAME", help="of the models of msb demo-data, as walled/two_dts")
    add("--seconds", type=float, default=60)
    add("--seed", type=int, default=0)
    add("--image-folder")
    add("--resolution", type=int)
    add("--twice", action="store_true", help="bake each twice, which must give the same bytes")
    add("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    pairs = list(zip(options.pairs[::2], options.pairs[1::2], strict=True))
    pairs = pairs or [(MODELS / name / method, scene) for name, scene in SCENES.items() for method in METHODS]
    of_scene = {"image_folder": options.image_folder, "resolution": options.resolution}
    facts = machine("numpy", "scipy", "pyopencl")
    print(", ".join(f"{key} {value}" for key, value in facts.items()), time.strftime("%Y-%m-%d"), sep="\n")
    print(HEADER, flush=True)
    rows, same = [], True
    for model, scene in pairs:
        name = "/".join(model.parts[-2:])
        if options.only and name not in options.only:
            continue
        for geometry in options.geometry:
            wanted = {
                "geometry": geometry,
                "seconds": options.seconds,
                "seed": options.seed,
                "scene": of_scene,
            }
            found = baked(model, scene, wanted)
            if options.twice:
                found["same_twice"] = baked(model, scene, wanted)["sha256"] == found["sha256"]
                same &= found["same_twice"]
            rows.append({"model": name, **found})
            print(row(name, found) + ("" if found.get("same_twice", True) else " OTHER BYTES"), flush=True)
    keep({"machine": facts, "rows": rows}, options.json)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
