"""Render and time the test views with a method's official code: official.py METHOD TIMING ARGUMENTS...

It runs in the environment and the folder of the official code. The function that the official evaluation
calls for each view is called again to time it: after a warm-up, with the graphics card idle before and after,
and without writing. A protocol takes the file TIMING (schema msb.renderer_timing/1) as `non_engine_timing`.

    triangle_splatting | mesh_splatting | three_dgs | two_dgs   render.py and its options
    two_dts      CONFIG SCENE DIVISOR MODEL RENDERS
    diffsoup     SCENE MODEL RENDERS
"""

from __future__ import annotations  # some of the environments have Python 3.7

import importlib
import json
import pathlib
import runpy
import sys
import time
from collections.abc import Callable
from typing import Any

import torch

WARM_UP, REPEATS = 10, 10  # calls before the first view, and calls of each view that are timed
sys.path.insert(0, ".")


class Timed:
    """A function that is called as before; each call is timed by further calls with the same arguments."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.frames, self.seconds = function, 0, 0.0

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        result = self.function(*arguments, **options)
        with torch.no_grad():
            for _ in range(0 if self.frames else WARM_UP):
                self.function(*arguments, **options)
            torch.cuda.synchronize()
            start = time.perf_counter()
            for _ in range(REPEATS):
                self.function(*arguments, **options)
            torch.cuda.synchronize()
        self.seconds += time.perf_counter() - start
        self.frames += REPEATS
        return result

    def write(self, path: str, what: str) -> None:
        """Write the timing of all calls."""
        record = {
            "schema": "msb.renderer_timing/1",
            "frames": self.frames,
            "seconds": self.seconds,
            "device": torch.cuda.get_device_name(0),
            "timed": f"{what} of the test views, {REPEATS} calls each after a warm-up, nothing written",
            "peak_gpu_memory_bytes": torch.cuda.max_memory_allocated(0),
        }
        pathlib.Path(path).write_text(json.dumps(record, indent=1) + "\n")


def save(image: torch.Tensor, path: pathlib.Path) -> None:
    """Write an image, (H, W, 3) from 0 to 1, truncated to bytes as in the official code."""
    from PIL import Image

    Image.fromarray((image.clamp(0, 1).cpu().numpy() * 255).astype("uint8")).save(path)


def time_render_script(package: str, arguments: list[str]) -> tuple[Timed, str]:
    """Run render.py, whose images are written as always, with the package's render() timed."""
    module: Any = importlib.import_module(package)
    module.render = timed = Timed(module.render)
    sys.argv = arguments
    runpy.run_path(arguments[0], run_name="__main__")
    return timed, "render()"


def time_two_dts(config: str, scene: str, divisor: str, model: str, renders: str) -> tuple[Timed, str]:
    """Run the evaluation of 2DTS on a trained model, and write the test views, which it does not."""
    from src.diff_recon import VanillaTSTrainer, loadConfig

    settings, place = loadConfig(config), pathlib.Path(scene)
    settings.dataset.local_dir, settings.dataset.scene_id = str(place.parent), place.name
    settings.dataset.train_target_res = settings.dataset.test_target_res = int(divisor)
    trainer = VanillaTSTrainer(settings, exp_name=place.name, device=0, log_file=False)
    last = max(pathlib.Path(model, "ckpt").glob("*.ckpt"), key=lambda path: int(path.stem))
    trainer.model.load_ckpt(str(last))
    timed, folder, number = Timed(trainer.model.forward), pathlib.Path(renders), 0

    def forward(*arguments: Any, **options: Any) -> Any:
        nonlocal number
        result = timed(*arguments, **options)
        save(result["render"].permute(1, 2, 0), folder / f"{number:05d}.png")
        number += 1
        return result

    folder.mkdir(parents=True, exist_ok=True)
    trainer.model.forward = forward
    trainer.evaluate()
    return timed, "model.forward()"


def time_diffsoup(scene: str, model: str, renders: str) -> tuple[Timed, str]:
    """Draw the test views of DiffSoup by the calls of its examples' evaluation, at the training's size."""
    sys.path.insert(0, "examples")
    import diffsoup
    from utils import load_mipnerf360_scene, mvp_from_K_Tcw, project_vertices

    trained = torch.load(pathlib.Path(model, "final_params.pt"), map_location="cuda", weights_only=False)
    size, dim, level = (trained["H"], trained["W"]), trained["feat_dim"], trained["Rmax"]
    network = diffsoup.ColorMLP(input_dim=dim + 9, hidden_dim=16, n_layers=2, output_dim=3).cuda()
    network.load_state_dict(trained["color_mlp"])
    if "flip_z" in trained:  # a scene of COLMAP
        data = load_mipnerf360_scene(scene, split="test", downscale=4, device="cuda")
        options = {"z_near": 0.5, "z_far": 100.0, "flip_z": trained["flip_z"]}
        views = [
            (frame["img_path"], mvp_from_K_Tcw(data["K"], frame["Tcw"], size, **options))
            for frame in data["frames"]
        ]
    else:
        example = importlib.import_module("03_random_init")
        cameras = example.load_cameras(pathlib.Path(scene, "transforms_test.json"))
        views = [(view.file_path, torch.from_numpy(view.MVP).float().cuda()) for view in cameras]

    def draw(matrix: torch.Tensor) -> torch.Tensor:
        corners = project_vertices(trained["V"], matrix)
        hits = diffsoup.rasterize_multires_triangle_alpha(
            size, corners, trained["F"], level=level, alpha_src=trained["alpha_acc"], stochastic=False
        )
        features = diffsoup.multires_triangle_color(hits, level=level, feat=trained["feat_acc"])
        directions = diffsoup.encode_view_dir_sh2(hits, torch.inverse(matrix).contiguous())
        inputs = torch.cat([features.view(-1, *size, dim), directions], dim=-1)
        color = network.forward(inputs, mask=hits[..., -1] > 0).view(*size, 3)
        if "flip_z" in trained:
            return color
        shown = (hits[0, ..., -1:] > 0).float()  # over white, and with the last row first
        return torch.flip(shown * color + (1 - shown), [0])

    timed, folder = Timed(draw), pathlib.Path(renders)
    folder.mkdir(parents=True, exist_ok=True)
    with torch.no_grad():
        for place, matrix in views:
            save(timed(matrix.unsqueeze(0)), folder / f"{pathlib.Path(place).stem}.png")
    return timed, "the calls of the examples' evaluation"


def main(method: str, timing: str, *arguments: str) -> None:
    """Render and time the test views of a method."""
    packages = {"three_dgs": "gaussian_renderer", "two_dgs": "gaussian_renderer"}
    if method == "two_dts":
        timed, what = time_two_dts(*arguments)
    elif method == "diffsoup":
        timed, what = time_diffsoup(*arguments)
    else:
        timed, what = time_render_script(packages.get(method, "triangle_renderer"), list(arguments))
    timed.write(timing, what)
    print(f"{timing}: {timed.frames / timed.seconds:.1f} frames per second")


if __name__ == "__main__":
    main(*sys.argv[1:])
