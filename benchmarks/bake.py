"""Measure bakes of trained models: quality, size, time and memory.

    python -m benchmarks.bake [MODEL SCENE ...]

The table has a row for each model and geometry: triangles, bytes, seconds and peak memory. It also has three
PSNRs against held-out photographs: of the native rendering, of the standard-tier mesh, and of the bake (with
1 and 16 samples per pixel). Each bake runs in a separate process. `--twice` repeats it and compares the
bytes. `--folder` keeps the files, for example `walled-two_dts-kept.glb`. The default models are the models of
`msb demo-data`; their surfaces are also compared with the true surface. `--image-folder` and `--resolution`
select the photographs. `--lods` and `--collision` add a second table, with the loss of each level of
detail relative to the full bake and the distance of the collision shape from the visible surface. `--picture`
writes an image with one row per model: held-out photograph, native rendering, standard-tier mesh, bakes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

import msb
from benchmarks.measure import keep, machine
from data_stubs import still_life
from data_stubs.captures import Y_DOWN
from msb.asset.tiers import why_not
from msb.bake.options import parse_lods
from msb.meshes.files import write_mesh
from msb.meshes.mesh import Mesh
from msb.metrics.ground_truth import ground_truth
from msb.scenes.datasets import Scene, dataset_of, scene_at

if TYPE_CHECKING:
    from msb.registry import Tier

Image = NDArray[np.float32]

MODELS = Path("data_stubs/models")
SCENES = {
    "pebble": Path("data_stubs/scenes/nerf_synthetic/pebble"),
    "walled": Path("data_stubs/scenes/mipnerf360/pebble"),
}
METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")
DEMO = {
    f"{name}/{method}": (MODELS / name / method, scene)
    for name, scene in SCENES.items()
    for method in METHODS
}
GEOMETRIES = ("kept", "fitted", "surface")
_COLUMNS = (
    *("model", "geometry", "own look", "plain, 1 sample", "baked, 1", "baked, 16"),
    *("triangles", "texture", "MB", "s", "peak MB", "verdict"),
)
HEADER = f"| {' | '.join(_COLUMNS)} |\n{'|---' * len(_COLUMNS)}|"
_BESIDE = (
    *("model", "geometry", "whole, dB", "levels, faces: dB"),
    *("collision", "faces", "parts", "distance, % of the diagonal", "protruding, %"),
)
BESIDE = f"| {' | '.join(_BESIDE)} |\n{'|---' * len(_BESIDE)}|"
_ONE = """
import json, resource, sys, time
import msb
from benchmarks.bake import read
model, scene, options, *outs = sys.argv[1:]
options = json.loads(options)
scene = read(model, scene, options.pop("scene"))
began = time.perf_counter()
report = msb.bake(model, scene=scene, **options).save(*outs, overwrite=True)
seconds = time.perf_counter() - began
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
print(json.dumps({**report.to_dict(), "seconds": seconds, "peak_mb": peak}))
"""


def baked(model: Path, scene: Path, options: dict[str, Any], place: Path) -> tuple[dict[str, Any], Image]:
    """Run one bake. Return its image, and its report with peak memory and the SHA-256 of its GLB.

    The files are written to `place` plus a suffix.
    """
    outs = [place.with_name(f"{place.name}{suffix}") for suffix in (".glb", ".triasset")]
    command = [sys.executable, "-c", _ONE, str(model), str(scene), json.dumps(options), *map(str, outs)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    for part in (found, *found["lods"], found["collision"] or {}):
        part.pop("output", None)
    del found["path"]
    hashed = hashlib.sha256(outs[0].read_bytes()).hexdigest()
    return found | {"sha256": hashed}, _view(msb.open(outs[1]), read(model, scene, options["scene"]))


def write_truths(folder: Path) -> dict[Path, str]:
    """Write the true surfaces of the demo scenes to `folder`; return the file of each scene."""
    surfaces = still_life.pebbles(), still_life.pebbles_before_a_wall().turned(Y_DOWN)
    truths = {}
    for scene, surface in zip(SCENES.values(), surfaces, strict=True):
        file = folder / f"truth-{scene.parent.name}.ply"
        write_mesh(Mesh(surface.vertices.astype(np.float32), surface.faces), file, suffix=".ply")
        truths[scene] = str(file)
    return truths


def read(model: str | Path, scene: str | Path, options: dict[str, Any]) -> Scene:
    """Return a scene with the evaluation rules of the model's method."""
    place = Path(scene)
    return scene_at(place, dataset_of(place), msb.open(model).manifest.method, **options).read()


def _view(asset: msb.Asset, scene: Scene, tier: Tier = "standard") -> Image:
    """Return the first test view. `fine` renders it with 16 samples per pixel."""
    more: dict[str, Any] = {"supersample": 4} if tier == "standard" else {}
    return msb.render(asset, scene.test[0], tier, scene.background, **more).image


def looks(model: Path, scene: Scene) -> list[Image]:
    """Return images of the first test view: photograph, native rendering and standard-tier mesh.

    A missing image is grey.
    """
    asset = msb.open(model)
    shown = [ground_truth(scene, scene.test[0]), _view(asset, scene, "dedicated")]
    has_mesh = why_not(asset.manifest, "standard") is None
    return [*shown, _view(asset, scene) if has_mesh else np.full_like(shown[0], 0.5)]


def row(name: str, report: dict[str, Any]) -> str:
    """Return the Markdown table row of one bake."""
    psnr = report["psnr"]["photographs"] or {"native": None, **report["psnr"]["native"]}
    decibels = [
        "" if psnr[key] is None else f"{psnr[key]:.2f}" for key in ("native", "before", "after", "after_16")
    ]
    texture = "" if report["texture"] is None else str(report["texture"][0])
    verdict = report["verdict_after"]["level"]
    facts = [f"{report['faces']:,}", texture, f"{report['bytes'] / 1e6:.2f}", f"{report['seconds']:.0f}"]
    return f"| {' | '.join([name, report['geometry'], *decibels, *facts, str(report['peak_mb']), verdict])} |"


def beside(name: str, report: dict[str, Any]) -> str:
    """Return the Markdown row of a bake's levels of detail and collision shape.

    For levels it has the loss of PSNR in dB relative to the full bake. PSNR is compared with native
    rendering, with 16 samples per pixel.
    """
    whole = report["psnr"]["native"]["after_16"]
    cells = [name, report["geometry"], f"{whole:.2f}"]
    cells.append(
        ", ".join(f"{one['faces']:,}: {one['native_after_16'] - whole:+.2f}" for one in report["lods"])
    )
    if shape := report["collision"]:
        cells += [shape["kind"], f"{shape['faces']:,}", f"{shape['parts']:,}"]
        cells += [f"{100 * shape['mean_distance']:.2f}", f"{100 * shape['mid_air_share']:.1f}"]
    return f"| {' | '.join(cells)} |"


def as_wide(picture: Image, wide: int) -> Image:
    """Return an image that is enlarged by an integer factor, and padded with white on the right to the width
    `wide`.
    """
    times = wide // picture.shape[1]
    larger = picture.repeat(times, axis=0).repeat(times, axis=1)
    return np.pad(larger, ((0, 0), (0, wide - larger.shape[1]), (0, 0)), constant_values=1)


def add_headings(picture: Pillow.Image, titles: Sequence[str]) -> Pillow.Image:
    """Return the image below a white band with the title of each of its columns, which are equally wide."""
    width, band = picture.width // len(titles), 36
    headed = Pillow.new("RGB", (picture.width, picture.height + band), "white")
    headed.paste(picture, (0, band))
    draw, font = ImageDraw.Draw(headed), ImageFont.load_default(24)
    for number, title in enumerate(titles):
        draw.text((width * (number + 0.5), band / 2), title, "black", font, anchor="mm")
    return headed


def main() -> int:
    """Run all bakes and print the tables; return 1 if a repeated bake differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("pairs", nargs="*", type=Path, metavar="MODEL SCENE", help="models, each followed by its scene")
    add("--geometry", nargs="+", default=GEOMETRIES, choices=(*GEOMETRIES, "auto"))
    add("--only", nargs="+", choices=DEMO, default=DEMO, metavar="NAME", help=f"of {', '.join(DEMO)}")
    add("--lods", type=parse_lods, default=())
    add("--collision", metavar="KIND")
    add("--seconds", type=float, help="as for msb bake; default: no limit")
    add("--seed", type=int, default=0)
    add("--image-folder")
    add("--resolution", type=int)
    add("--twice", action="store_true", help="repeat each bake and compare the bytes")
    add("--folder", type=Path, help="keep the baked files here; default: a temporary folder")
    add("--picture", type=Path, metavar="PNG")
    add("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        return _all(options, folder)


def _all(options: argparse.Namespace, folder: Path) -> int:
    pairs = list(zip(options.pairs[::2], options.pairs[1::2], strict=True))
    pairs = pairs or [DEMO[name] for name in options.only]
    of_scene = {"image_folder": options.image_folder, "resolution": options.resolution}
    facts = machine("numpy", "scipy", "pyopencl")
    print(", ".join(f"{key} {value}" for key, value in facts.items()), time.strftime("%Y-%m-%d"), sep="\n")
    print(HEADER, flush=True)
    rows, pictures, same, truths = [], [], True, write_truths(folder)
    for model, scene in pairs:
        name = "/".join(model.parts[-2:])
        pictures.append(looks(model, read(model, scene, of_scene)))
        for geometry in options.geometry:
            wanted = {
                "geometry": geometry,
                "seconds": options.seconds,
                "seed": options.seed,
                "lods": options.lods,
                "collision": options.collision,
                "scene": of_scene,
                "truth": truths.get(scene),
            }
            place = folder / f"{name.replace('/', '-')}-{geometry}"
            found, picture = baked(model, scene, wanted, place)
            pictures[-1].append(picture)
            if options.twice:
                found["same_twice"] = baked(model, scene, wanted, place)[0]["sha256"] == found["sha256"]
                same &= found["same_twice"]
            rows.append({"model": name, **found})
            print(row(name, found) + ("" if found.get("same_twice", True) else " OTHER BYTES"), flush=True)
    if options.lods or options.collision:
        print("", BESIDE, *(beside(one["model"], one) for one in rows), sep="\n")
    if options.picture and pictures:
        rows_of = [np.concatenate(each, axis=1) for each in pictures]
        wide = max(one.shape[1] for one in rows_of)
        whole = np.concatenate([as_wide(one, wide) for one in rows_of])
        picture = Pillow.fromarray(np.uint8(np.floor(whole.clip(0, 1) * 255 + 0.5)))
        titles = ["photograph", "native rendering", "exported mesh"]
        add_headings(picture, [*titles, *(f"baked, {name}" for name in options.geometry)]).save(
            options.picture
        )
    keep({"machine": facts, "rows": rows}, options.json)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
