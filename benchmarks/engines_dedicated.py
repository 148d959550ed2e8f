"""Compare three renderers: the dedicated tier as a graphics pipeline, the dedicated tier in OpenCL, and a
plain mesh in three.js.

All renderers of a scene take turns within a round, so that changes of the machine's speed affect all equally.
Times are medians over the rounds. If a device has timestamps, it measures the times itself. Otherwise they
are wall-clock times. Every image is compared with the image of our OpenCL kernels. This image agrees with the
official image to 136 dB or more.

A software adapter computes on the same processor as our kernels. Its images, its memory and the shares of its
stages are valid. Its times say nothing about a graphics card.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import msb
from benchmarks.dedicated_scenes import BLENDED, camera, capture, psnr
from benchmarks.garden import surface_of
from data_stubs.made_models import write_models
from msb.engines.engine import WALL_CLOCK
from msb.registry import METHODS
from msb.render.backend import SETTLED_AT, why_unavailable

if TYPE_CHECKING:
    from msb import Asset, Camera

OURS = "OpenCL"
RENDERERS: dict[str, tuple[str, dict[str, Any]]] = {
    OURS: ("dedicated", {"outputs": ()}),
    "wgpu": ("dedicated", {"name": "wgpu"}),
    "wgpu, samples never stop": ("dedicated", {"name": "wgpu", "stops": 1}),
    "wgpu, half floats": ("dedicated", {"name": "wgpu", "half": True}),
    "wgpu, `order=global`": ("dedicated", {"name": "wgpu", "order": "global"}),
    "wgpu, `order=none`": ("dedicated", {"name": "wgpu", "order": "none"}),
    "wgpu, `sampling=engine`": ("dedicated", {"name": "wgpu", "sampling": "engine"}),
    "wgpu, `engine` and `none`": ("dedicated", {"name": "wgpu", "sampling": "engine", "order": "none"}),
    "three.js, the plain mesh": ("standard", {"name": "threejs"}),
}
"""Tier and options of the renderer in each row of the table."""
STAGES = ("project", "sort", "records", "bin", "blend", "resolve")
BLACK = (0.0, 0.0, 0.0)


def synthetic(faces: int) -> Iterator[tuple[str, Asset, list[Camera]]]:
    """Yield a model of every blended method with about this number of faces."""
    for method in BLENDED:
        yield METHODS[method].title, capture(method, faces), [camera(620, 411)]


def captured(garden: Path) -> Iterator[tuple[str, Asset, list[Camera]]]:
    """Yield models with a triangle at every SfM point of a capture, and four cameras of the capture."""
    if not garden.exists():
        return
    cameras = [seen.resized(648, 420) for seen in msb.read_cameras(garden / "sparse" / "0")[::8]]
    with tempfile.TemporaryDirectory() as folder:
        write_models(Path(folder), surface_of(garden), white=False, layout="colmap")
        for method in BLENDED:
            yield METHODS[method].title, msb.export(Path(folder) / method), cameras


def compare(asset: Asset, cameras: list[Camera], rounds: int) -> list[dict[str, Any]]:
    """Return a row for each renderer.

    Our OpenCL renderer comes first. The row of a renderer that cannot draw has the reason.
    """
    rows: list[dict[str, Any]] = []
    running: dict[str, msb.Renderer] = {}
    official: list[Any] = []
    try:
        for title, (tier, options) in RENDERERS.items():
            row: dict[str, Any] = {"renderer": title, "rounds": []}
            rows.append(row)
            missing = why_unavailable(options["name"]) if "name" in options else None
            if missing is not None:
                row["error"] = missing
                continue
            try:
                renderer = running[title] = msb.Renderer(asset, tier, **options)  # type: ignore[arg-type]
                for _ in range(SETTLED_AT):
                    images = [renderer.render(seen, BLACK).image for seen in cameras]
            except msb.MsbError as error:
                row["error"] = str(error)
                if title == OURS or not isinstance(error, msb.Unsupported):
                    raise
                continue
            official = official or images
            row["psnr"] = [
                psnr(image, own, quantize=False) for image, own in zip(images, official, strict=True)
            ]
            row["bytes"] = sum(renderer.memory().values())
            row["drawn_by"] = [renderer.name, *(renderer.device_info or {}).values()]
        for _ in range(rounds):
            for row in rows:
                if "error" not in row:
                    renderer = running[row["renderer"]]
                    row["rounds"].append([dict(renderer.draw(seen, BLACK).stages) for seen in cameras])
    finally:
        for renderer in running.values():
            renderer.close()
    return rows


def stage_times(row: dict[str, Any]) -> dict[str, float]:
    """Return for each stage the median milliseconds per frame, over all cameras."""
    frames = [frame for turn in row["rounds"] for frame in turn]
    return {stage: median(frame[stage] for frame in frames) for stage in frames[0]}


def print_table(title: str, rows: list[dict[str, Any]]) -> None:
    """Print the rows of a method in Markdown."""
    print(f"\n**{title}**\n")
    print("| renderer | " + " | ".join(STAGES) + " | frame, ms | / ours | dB to ours, least | MB |")
    print("|---" * (len(STAGES) + 5) + "|")
    ours = sum(stage_times(rows[0]).values())
    for row in rows:
        if "error" in row:
            print(f"| {row['renderer']} | not drawn: {row['error']} |")
            continue
        times = stage_times(row)
        cells = [f"{times[stage]:.1f}" if stage in times else "-" for stage in STAGES]
        whole = sum(times.values())
        note = " (wall clock)" if WALL_CLOCK in times else ""
        equal = "-" if row is rows[0] else f"{min(row['psnr']):.1f}"
        cells += [f"{whole:.1f}{note}", f"{whole / ours:.2f}", equal, f"{row['bytes'] / 1e6:.0f}"]
        print(f"| {row['renderer']} | " + " | ".join(cells) + " |", flush=True)
