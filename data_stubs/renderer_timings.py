"""Time our NumPy reference on the demo's models: `python -m data_stubs.renderer_timings` takes half a minute.

The `renderer.json` of each model fills the frame rate of the demo's Non-Engine condition. The record states
that this is not the speed of the method's own renderer, which needs CUDA (docs/official.md has the scripts).
"""

from __future__ import annotations

import sys
import time

import msb
from data_stubs.trainings import HERE, STUBS
from msb.base.atomic import new_file
from msb.bench.records import RendererTiming
from msb.scenes.datasets import read_scene


def main() -> int:
    """Write `renderer.json` into each folder of `data_stubs/models`."""
    for training in sorted((HERE / "models").glob("*/*/training.json")):
        folder = training.parent
        scene_path, *options = STUBS[folder.parent.name]
        named = dict(zip(options[::2], options[1::2], strict=True))
        scene = read_scene(HERE / "scenes" / scene_path, image_folder=named.get("--image-folder"))
        with msb.Renderer(msb.open(folder), "reference") as renderer:
            # The first image also fills caches, and is not timed. Processor time does not depend on the load.
            renderer.render(scene.test[0], scene.background)
            start = time.process_time()
            for camera in scene.test:
                renderer.render(camera, scene.background)
            seconds = time.process_time() - start
        record = RendererTiming(
            frames=len(scene.test),
            seconds=round(seconds, 3),
            device="a CPU core of the demo data's authors",
            timed=f"processor time of our NumPy reference for {len(scene.test)} test views after one more; "
            "the method's own renderer needs CUDA and was not timed",
        )
        with new_file(folder / "renderer.json") as file:
            file.write(record.model_dump_json(by_alias=True, exclude_none=True, indent=1).encode() + b"\n")
        print(f"{folder.parent.name}/{folder.name}: {record.fps:.2f} frames per second", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
