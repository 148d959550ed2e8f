"""Compare images of other engines with the standard tier.

One of the comparisons uses the default colour settings of the engines.

    python -m benchmarks.engines                               all scenes, all installed engines
    python -m benchmarks.engines --scenes goldens --engines wgpu
    python -m benchmarks.engines --tier dedicated             stages, memory and dB of the dedicated tier
    python -m benchmarks.engines --pictures docs/images        images for docs/engines.md

The program prints the tables of benchmarks/pages/engines.md. `--json` writes the figures.
engines_dedicated.py explains `--tier dedicated`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msb
from benchmarks import engines_dedicated
from benchmarks.measure import keep, machine
from benchmarks.standard_scenes import FOCAL, HEIGHT, WIDTH, pose, shell
from data_stubs.make import splat_like_asset
from msb import Camera
from msb.asset import Description, build_asset
from msb.engines.agreement import agreement
from msb.registry import METHODS
from msb.render.backend import ENGINES, why_unavailable
from msb.render.images import to_bytes
from tests.golden.views import METHODS as OFFICIAL
from tests.reference.golden import exported, golden_views

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.render import Frame

GARDEN = Path(__file__).parent.parent.parent / "shared" / "golden" / "garden"


class Task(NamedTuple):
    """An asset with its views."""

    asset: Asset
    views: list[tuple[Camera, tuple[float, ...]]]
    settings: dict[str, Any]


def goldens() -> Iterator[Task]:
    """Yield the golden scenes: the meshes of their checkpoints, and the cameras of the scenes."""
    for method in (name for name in OFFICIAL if METHODS[name].supports("standard")):
        for view in golden_views(method):
            chosen = {key: view.settings[key] for key in ("ste_threshold",) if key in view.settings}
            yield Task(exported(view.folder / "checkpoint"), [(view.camera, view.background)], chosen)


def garden() -> Iterator[Task]:
    """Yield a mesh of a real training with real cameras."""
    if not GARDEN.exists():
        return
    cameras = msb.read_cameras(GARDEN / "sparse" / "0")[::8]
    views = [(camera.resized(648, 420), (0.0, 0.0, 0.0)) for camera in cameras]
    yield Task(msb.export(GARDEN / "vase_mesh.ply"), views, {})


def million() -> Iterator[Task]:
    """Yield a mesh of a million faces like those of MeshSplatting.

    Its camera has an off-centre principal point and pixels that are not square.
    """
    yield Task(splat_like_asset(194), [(oblong(960, 720), (1.0, 1.0, 1.0))], {})


def soup() -> Iterator[Task]:
    """Yield the worst case: a million crossing faces of about a pixel, with random vertex colours."""
    scene = shell(1_000_000)
    buffers = {"positions": scene.positions, "indices": scene.indices, "color": scene.colors}
    asset = build_asset(buffers, {"color": "vertex"}, Description(appearance={"kind": "static_color"}))
    camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose())
    yield Task(asset, [(camera, (0.0, 0.0, 0.0))], {})


SCENES: dict[str, tuple[str, Callable[[], Iterator[Task]]]] = {
    "goldens": ("the golden scenes of three methods", goldens),
    "garden": ("a mesh of real training, four real cameras", garden),
    "million": ("a MeshSplatting-like mesh of 1 M faces, off-centre camera, fx = 1.1 fy", million),
    "soup": ("1 M crossing faces of a pixel, random colours: the worst case", soup),
}


def oblong(width: int, height: int) -> Camera:
    """Return a camera in front of a splat-like mesh. Its principal point is off-centre, and fx = 1.1 fy."""
    camera = Camera.look_at(
        (0.9, 0.2, 1.7), (0.5, 0.5, 0.5), up=(0, 1, 0), width=width, height=height, fov_y=0.6
    )
    return replace(camera, fx=1.1 * camera.fy, cx=0.45 * width, cy=0.53 * height)


def drawn(name: str, task: Task, **options: Any) -> tuple[str, list[Frame]]:
    """Return the renderer's description, and its frames."""
    chosen = None if name == "standard" else name
    with msb.Renderer(task.asset, "standard", settings=task.settings, name=chosen, **options) as renderer:
        about = renderer.device_info or {}
        text = ", ".join([renderer.name, *(about[key] for key in ("platform", "name") if key in about)])
        return text, [renderer.render(camera, background) for camera, background in task.views]


def compare(scene: str, engines: list[str]) -> list[dict[str, Any]]:
    """Return a row for each engine."""
    tasks = list(SCENES[scene][1]())
    if not tasks:
        print(f"{scene}: skipped, its data is missing")
        return []
    ours = [frame for task in tasks for frame in drawn("standard", task)[1]]
    rows = []
    for engine in engines:
        theirs, about = [], ""
        for task in tasks:
            about, frames = drawn(engine, task)
            theirs += frames
        rows.append({"engine": engine, "drawn_by": about, **asdict(agreement(theirs, ours))})
    return rows


DEDICATED: dict[str, tuple[str, Callable[[], Iterator[tuple[str, Asset, list[Camera]]]]]] = {
    "capture": ("100,000 faces of a synthetic capture", lambda: engines_dedicated.synthetic(100_000)),
    "capture-1M": ("a million faces of a synthetic capture", lambda: engines_dedicated.synthetic(1_000_000)),
    "garden": (
        "triangles at 138,766 points of a capture, four real cameras",
        lambda: engines_dedicated.captured(GARDEN),
    ),
}
"""Scenes of the dedicated tier: a model of each blended method."""


def compare_dedicated(scenes: list[str], rounds: int) -> dict[str, Any]:
    """Print the tables of the dedicated tier, and return their rows by scene and method."""
    found: dict[str, Any] = {}
    for scene in scenes:
        what, make = DEDICATED[scene]
        for method, asset, cameras in make():
            rows = found.setdefault(scene, {})[method] = engines_dedicated.compare(asset, cameras, rounds)
            engines_dedicated.print_table(f"{what}: {method}, {rounds} rounds", rows)
        if scene not in found:
            print(f"{scene}: skipped, its data is missing")
    drawn_by = {
        row["renderer"]: ", ".join(row["drawn_by"])
        for by_method in found.values()
        for rows in by_method.values()
        for row in rows
        if "drawn_by" in row
    }
    print("\n" + "\n\n".join(f"{renderer}: {about}" for renderer, about in drawn_by.items()))
    print("\nTimes of a software adapter do not apply to graphics cards.")
    return found


def print_table(scene: str, rows: list[dict[str, Any]]) -> None:
    """Print a scene's rows in Markdown."""
    first = rows[0]
    print(f"\n**{SCENES[scene][0]}** ({first['pixels']:,} pixels, {first['interior']:,} of them interior)\n")
    print("| renderer | within a level | PSNR | covered alike | interior within a level | 99.9 % | max |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| `{row['engine']}` | {100 * row['within_a_level']:.3f} % | {row['psnr']:.1f} dB "
            f"| {100 * row['covered_alike']:.3f} % | {100 * row['interior_within_a_level']:.3f} % "
            f"| {row['interior_p999']:.0f} | {row['interior_max']:.0f} |"
        )
    sys.stdout.flush()


PICTURES: list[tuple[str, str, dict[str, Any]]] = [
    ("MeshSplatBench", "standard", {}),
    ("three.js, correct settings", "threejs", {}),
    ("three.js, default settings, sRGB GLB", "threejs", {"defaults": True}),
    ("Blender, correct settings", "blender_cycles", {}),
    ("Blender, default settings, PLY", "blender_cycles", {"defaults": True}),
    ("Blender, default settings, sRGB GLB", "blender_cycles", {"defaults": True, "source": "glb"}),
]


def write_pictures(folder: Path) -> None:
    """Write engine_colors.png: a mesh in several engines, with correct and with default colour settings."""
    from PIL import Image, ImageDraw, ImageFont

    size, margin, gap = 250, 24, 10
    camera = Camera.look_at(
        (1.3, 0.8, 2.6), (0.5, 0.5, 0.5), up=(0, 1, 0), width=size, height=size, fov_y=0.4
    )
    task = Task(splat_like_asset(36), [(camera, (1.0, 1.0, 1.0))], {})
    sheet = Image.new("RGB", (3 * size + 2 * gap, 2 * (size + margin)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for number, (title, name, options) in enumerate(PICTURES):
        frame = drawn(name, task, **options)[1][0]
        left, top = number % 3 * (size + gap), number // 3 * (size + margin)
        sheet.paste(Image.fromarray(to_bytes(frame.image)), (left, top + margin))
        draw.text((left + size / 2, top + margin / 2), title, "black", font, anchor="mm")
    folder.mkdir(parents=True, exist_ok=True)
    sheet.quantize(256).save(folder / "engine_colors.png", optimize=True)


def compare_standard(scenes: list[str], names: list[str]) -> dict[str, Any]:
    """Print the tables of the standard tier, and return their rows by scene."""
    engines = []
    for name in names:
        missing = why_unavailable(name)
        if missing is None:
            engines.append(name)
        else:
            print(f"{name}: not compared: {missing}")
    found: dict[str, Any] = {}
    for scene in scenes:
        rows = found[scene] = compare(scene, engines)
        if rows:
            print_table(scene, rows)
    for row in next(rows for rows in found.values() if rows):
        print(f"\n{row['engine']}: {row['drawn_by']}")
    return found


def main() -> None:
    """Compare and print, or write the images."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--tier", choices=["standard", "dedicated"], default="standard")
    parser.add_argument("--scenes", nargs="+", help=f"{', '.join(SCENES)}; dedicated: {', '.join(DEDICATED)}")
    parser.add_argument("--engines", nargs="+", choices=list(ENGINES), default=list(ENGINES))
    parser.add_argument("--rounds", type=int, default=9, help="rounds of the dedicated tier")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--pictures", type=Path, help="only write the images, into this folder")
    options = parser.parse_args()
    if options.pictures:
        write_pictures(options.pictures)
        return
    there: dict[str, Any] = SCENES if options.tier == "standard" else DEDICATED
    scenes = options.scenes or list(there)
    if unknown := set(scenes) - there.keys():
        parser.error(f"no scene of tier {options.tier}: {', '.join(sorted(unknown))}")
    record: dict[str, Any] = {"machine": machine("numpy", "wgpu", "pyopencl"), "scenes": {}}
    record["titles"] = {scene: there[scene][0] for scene in scenes}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    if options.tier == "dedicated":
        record["scenes"] = compare_dedicated(scenes, options.rounds)
    else:
        record["scenes"] = compare_standard(scenes, options.engines)
    keep(record, options.json)


if __name__ == "__main__":
    main()
