"""Time an iteration of the trainer for several numbers of pixels and triangles: `python -m
benchmarks.training`.

One scene is trained at several image sizes and triangle counts. The time is the minimum over several
iterations, because other load only adds time. The next column shows the CPU time of all threads. Needs the
extra train.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch

from data_stubs.training.loop import Length, Training
from data_stubs.training.methods import MODELS
from data_stubs.training.model import Options
from data_stubs.training.scene import read_capture

_ROUNDS = 5
SCENE = Path("data_stubs/scenes/mipnerf360/pebble")


def main() -> None:
    """Print a line for each method, size and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=SCENE)
    parser.add_argument("--image-folder", default="images")
    parser.add_argument("--widths", type=int, nargs="+", default=[160, 320])
    parser.add_argument("--faces", type=int, nargs="+", default=[5000, 20000])
    parser.add_argument("--methods", nargs="+", default=list(MODELS))
    options = parser.parse_args()
    print(f"threads {torch.get_num_threads()}")
    print(f"{'method':20s} {'pixels':>8s} {'faces':>7s} {'pairs':>9s} {'seconds':>8s} {'processor':>9s}")
    for method in options.methods:
        for width in options.widths:
            capture = read_capture(options.scene, method, options.image_folder, width, 0)
            for faces in options.faces:
                # Request twice as many triangles. If the scene has enough points, training starts with half
                # of the requested number.
                model = MODELS[method](capture, Options(faces=2 * faces, sh_degree=1))
                training = Training(model, Length(1, 100), Path("out/training-benchmark"), {})
                camera, _ = capture.train[0]
                pairs = len(model.draw(camera, model.settings(0)).pairs.x)
                seconds: list[tuple[float, float]] = []
                for _ in range(_ROUNDS):
                    start = time.perf_counter(), time.process_time()
                    training.step()
                    seconds.append((time.perf_counter() - start[0], time.process_time() - start[1]))
                size = f"{camera.width * camera.height:8d} {model.faces:7d} {pairs:9d}"
                wall, processor = (min(values) for values in zip(*seconds, strict=True))
                print(f"{method:20s} {size} {wall:8.3f} {processor:9.3f}", flush=True)


if __name__ == "__main__":
    main()
