"""Optimise a small model of a scene: `python -m data_stubs.training --scene DIR --method M --minutes 30`."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from msb.errors import MsbError, UsageError


def main() -> int:
    """Train, and return the exit status: 130 if it was interrupted."""
    options = _arguments()
    try:
        return _train(options)
    except ImportError as error:
        if error.name != "torch":
            raise
        print("error: training needs torch: pip install 'meshsplatbench[train]'", file=sys.stderr)
        return 2
    # this is the second Ctrl-C; the first one stops the training after the current iteration
    except KeyboardInterrupt:
        return 130
    except MsbError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m data_stubs.training", description=__doc__)
    add = parser.add_argument
    add("--scene", type=Path, required=True, help="folder of a scene, in a layout of docs/datasets.md")
    methods = "two_dts, triangle_splatting, mesh_splatting, diffsoup, three_dgs or two_dgs"
    add("--method", required=True, help=methods)
    add("--minutes", type=float, default=30, help="minutes to train (30)")
    add(
        "--iterations",
        type=int,
        help="number of iterations instead of a time; the result then does not depend on the machine",
    )
    add("--faces", type=int, default=8000, help="most triangles or Gaussians (8000)")
    add(
        "--image-folder", help="folder of the photographs, such as images_2, instead of the dataset's default"
    )
    add(
        "--points",
        type=Path,
        help="folder of another scene with SfM points to start from, for a scene without points",
    )
    add(
        "--resolution",
        type=int,
        help="1, 2, 4 or 8 divides the photographs' size; any other number is a width in pixels",
    )
    add("--sh-degree", type=int, default=2, choices=range(4), help="degree of the spherical harmonics (2)")
    add("--rasterizer", default="3D", choices=("2D", "3D"), help="2DTS' rasterizer (3D)")
    add("--gamma", type=float, default=50, help="2DTS' final sharpness; 1 disables sharpening (50)")
    add("--level", type=int, default=2, choices=range(6), help="level of DiffSoup's lattices (2)")
    add("--seed", type=int, default=0, help="seed of all random numbers (0)")
    add("--output", type=Path, default=Path("out/training"), help="folder of the model (out/training)")
    add("--resume", action="store_true", help="continue the training in the output folder")
    return parser.parse_args()


def _train(options: argparse.Namespace) -> int:
    from data_stubs.training.loop import Length, Training
    from data_stubs.training.methods import MODELS
    from data_stubs.training.model import Options
    from data_stubs.training.scene import read_capture

    if options.method not in MODELS:
        raise UsageError("USAGE", f"--method is {options.method}; it must be {', '.join(MODELS)}")
    if not options.minutes > 0 or options.faces < 1 or not options.gamma >= 1:
        raise UsageError("USAGE", "--minutes and --faces must be positive, --gamma at least 1")
    capture = read_capture(
        options.scene,
        options.method,
        options.image_folder,
        options.resolution,
        options.seed,
        points=options.points,
    )
    chosen = Options(
        faces=options.faces,
        sh_degree=options.sh_degree,
        seed=options.seed,
        rasterizer=options.rasterizer,
        gamma=options.gamma,
        level=options.level,
    )
    model = MODELS[options.method](capture, chosen)
    command = {"scene": options.scene.name, "minutes": options.minutes, "iterations": options.iterations}
    training = Training(model, Length(options.minutes, options.iterations), options.output, command)
    if options.resume:
        training.resume()
    stops: list[int] = []

    def stop(number: int, frame: object) -> None:
        if stops:
            raise KeyboardInterrupt
        stops.append(number)
        print("stopping after this iteration; continue with --resume", file=sys.stderr)

    signal.signal(signal.SIGINT, stop)
    training.run(lambda: bool(stops))
    if training.log and training.progress >= 1:
        last = training.log[-1]
        print(f"{options.output}: {last['psnr']} dB held-out, {last['faces']} faces")
    return 130 if stops else 0


if __name__ == "__main__":
    sys.exit(main())
