"""Measure the seconds, memory and bytes per face of each step with ten million triangles of each method.

    python -m benchmarks.scale                   10 million triangles of SH degree 3, every method
    python -m benchmarks.scale --faces 1000000 --method diffsoup --folder /path/with/room

Each step runs in a fresh process, like a command. The steps are the export of the checkpoint, the audit, the
first frame of each tier at 1237 x 822 pixels (with start-up), and the repairs orient and pair. Two further
steps compute the face weights of the page over 8 views of 640 x 480 pixels, by OpenCL and by the NumPy
reference. The last step writes the page of the dedicated tier with the 100,000 faces that contribute most,
and compares 4 views of it with the full model. Memory is the peak of the process. It includes mapped files,
and on a CPU the buffers of the device. `private` excludes memory backed by files, because the system can drop
it.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.dedicated_scenes import SIZES, camera, grid_mesh, is_connected, soup
from benchmarks.measure import keep, machine, peak
from data_stubs.made_models import TRAINED
from data_stubs.torch_file import write_torch

_ASSET = "scale.triasset"
_PAGE_FACES = 100_000
_HOLES = 1.287
"""Ratio of the faces of the full grid to the remaining faces. The other faces are omitted and leave holes."""
_INTERVAL = 0.005
"""Sampling interval of a process's private memory, in seconds."""


def write_checkpoint(folder: Path, method: str, faces: int) -> None:
    """Write a checkpoint of `method` like a training. It holds a scene of `benchmarks.dedicated_scenes`."""
    is_mesh = method == "diffsoup" or is_connected(method)
    buffers = grid_mesh(round(_HOLES * faces)) if is_mesh else soup(faces)
    if method == "diffsoup":
        write_torch(folder / "final_params.pt", _diffsoup(buffers), "final_params")
        return
    indices, rows = buffers["indices"], len(buffers["opacity"])
    opacity, f_dc = buffers["opacity"].reshape(rows, 1), buffers["f_dc"].reshape(rows, 1, 3)
    f_rest = buffers["f_rest"].reshape(rows, -1, 3)
    if method == "two_dts":
        corners = buffers["positions"].reshape(-1, 3, 3)
        (folder / "ckpt").mkdir()
        params = {"_vertex": corners, "_opacity": opacity, "_f_dc": f_dc, "_f_rest": f_rest}
        write_torch(folder / "ckpt" / "30000.ckpt", (params, {}, None, 1.0), "30000")
        (folder / "config.yaml").write_text("model:\n  rasterizer_type: 2D\n  max_sh_degree: 3\n")
        return
    values: dict[str, Any] = {"active_sh_degree": 3, "features_dc": f_dc, "features_rest": f_rest}
    if method == "triangle_splatting":
        values["triangles_points"] = buffers["positions"].reshape(-1, 3, 3)
        values["sigma"] = np.full((rows, 1), 0.15, np.float32)
        values["opacity"] = opacity
    else:
        values["triangles_points"] = buffers["positions"]
        values["_triangle_indices"] = indices.view(np.int32)
        values["vertex_weight"] = opacity
        values["sigma"] = float(np.log(1e-4))
        if method == "triangle_splatting_plus":
            values["importance_score"] = np.ones(len(indices), np.float32)
            values["image_size"] = np.full(len(indices), 20, np.float32)
        else:
            values["pixel_count"] = np.full(len(indices), 100, np.int32)
    model = folder / "point_cloud" / "iteration_30000"
    model.mkdir(parents=True)
    write_torch(model / "point_cloud_state_dict.pt", values, "point_cloud_state_dict")


def _diffsoup(buffers: dict[str, Any]) -> dict[str, Any]:
    """Return DiffSoup parameters of a level-0 mesh with random features and a random decoder."""
    random, faces = np.random.default_rng(1), len(buffers["indices"])
    sizes = {"0": (16, 16), "2": (16, 16), "4": (3, 16)}
    decoder = {f"mlp.{layer}.weight": random.normal(0, 0.3, shape) for layer, shape in sizes.items()}
    decoder |= {f"mlp.{layer}.bias": np.zeros(shape[0]) for layer, shape in sizes.items()}
    return {
        "feat_acc": random.random((faces, 3, 7), np.float32),
        "alpha_acc": random.random((faces, 3, 1), np.float32),
        "V": buffers["positions"],
        "F": buffers["indices"].view(np.int32),
        "color_mlp": {key: value.astype(np.float32) for key, value in decoder.items()},
        "Rmin": 0,
        "Rmax": 0,
        "feat_dim": 7,
        "H": SIZES[1][1],
        "W": SIZES[1][0],
        "flip_z": True,
        "steps": 1000,
    }


def export(folder: Path) -> int:
    """Export and save; return the number of faces."""
    import msb

    asset = msb.export(folder)
    msb.save(asset, folder / _ASSET, overwrite=True)
    return asset.manifest.face_count


def audit(folder: Path) -> int:
    """Audit the asset."""
    import msb

    return msb.audit(msb.load(folder / _ASSET)).counts.faces


def draw(folder: Path, tier: Any) -> int:
    """Render one frame."""
    import msb

    asset = msb.load(folder / _ASSET)
    msb.render(asset, camera(*SIZES[1]), tier=tier)
    return asset.manifest.face_count


def repair(folder: Path) -> int:
    """Orient the faces, and pair the faces at edges with more than two of them."""
    import msb

    return msb.repair(folder / _ASSET, "orient,pair").asset.manifest.face_count


def weigh(folder: Path) -> int:
    """Add up the contribution of each face to the views of a page, with OpenCL."""
    import msb
    from msb.render.shares import shares_by_view

    asset = msb.load(folder / _ASSET)
    weights = np.zeros(asset.manifest.face_count)
    for shares in shares_by_view(asset, ((view, None) for view in _views(asset))):
        weights += 0 if shares is None else shares[:, 0]
    return len(weights)


def weigh_by_reference(folder: Path) -> int:
    """Add up the same contributions with the NumPy reference."""
    import msb
    from msb.reference import render_reference

    asset = msb.load(folder / _ASSET)
    weights = sum(render_reference(asset, view).contribution for view in _views(asset))
    return len(weights)


def _views(asset: Any) -> list[Any]:
    from msb.engines.command import TEST_SIDE, TEST_VIEWS
    from msb.scenes.around import make_turntable

    return make_turntable(asset, 2 * TEST_VIEWS, TEST_SIDE, TEST_SIDE * 3 // 4, "+y")


def page(folder: Path) -> int:
    """Write the page of the dedicated tier with the faces that contribute most, like `msb web`."""
    import msb
    from msb.cli.app import app

    command = ["web", "--tier", "dedicated", "--faces", str(_PAGE_FACES), "--no-verify", "--quiet"]
    app([*command, "-o", str(folder / "page.html"), str(folder / _ASSET)], standalone_mode=False)
    return msb.load(folder / _ASSET).manifest.face_count


STEPS: dict[str, Callable[[Path], int]] = {
    "export": export,
    "audit": audit,
    "standard": lambda folder: draw(folder, "standard"),
    "dedicated": lambda folder: draw(folder, "dedicated"),
    "repair": repair,
    "weigh": weigh,
    "by NumPy": weigh_by_reference,
    "page": page,
}


class PrivateMemory(threading.Thread):
    """Sample the private memory of this process in bytes, every few milliseconds.

    On systems other than Linux it is 0.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.most = self._now()

    def run(self) -> None:
        while True:
            self.most = max(self.most, self._now())
            time.sleep(_INTERVAL)

    @staticmethod
    def _now() -> int:
        status = Path("/proc/self/status")
        text = status.read_text() if status.exists() else ""
        return sum(int(kb) for kb in re.findall(r"Rss(?:Anon|Shmem):\s*(\d+) kB", text)) * 1024


def measure(step: str, folder: Path) -> dict[str, Any]:
    """Run one step in this process. Return its time and memory."""
    import msb

    before = peak()
    private = PrivateMemory()
    private.start()
    start = time.perf_counter()
    try:
        faces = STEPS[step](folder)
    except msb.Unsupported as error:
        return {"unsupported": error.message}
    seconds = time.perf_counter() - start
    size = (folder / _ASSET).stat().st_size
    return {
        "seconds": seconds,
        "faces": faces,
        "before": before,
        "peak": peak(),
        "private": private.most,
        "asset": size,
    }


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--faces", type=int, default=10_000_000)
    parser.add_argument(
        "--method", choices=TRAINED, action="append", help="default: all, one after the other"
    )
    parser.add_argument("--folder", type=Path, help="folder with 5 GB of space; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--step", choices=STEPS, action="append", help="after export; default: all")
    parser.add_argument("--worker", choices=["write", *STEPS], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker == "write":
        write_checkpoint(options.folder, options.method[0], options.faces)
        return
    if options.worker:
        print(json.dumps(measure(options.worker, options.folder)))
        return
    record: dict[str, Any] = {
        "machine": machine("numpy", "pyopencl", "pocl-binary-distribution"),
        "steps": {},
    }
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    heads = f"{'seconds':>8}{'peak GB':>9}{'private GB':>12}{'a face':>8}{'private':>9}"
    print(f"\n{'method':<24}{'step':<11}{heads}")
    for method in options.method or TRAINED:
        with tempfile.TemporaryDirectory(dir=options.folder) as name:
            arguments = ["--method", method, "--faces", str(options.faces), "--folder", name]
            run("write", *arguments)
            wanted = [step for step in STEPS if step in ("export", *(options.step or STEPS))]
            steps = {step: json.loads(run(step, *arguments)) for step in wanted}
        record["steps"][method] = steps
        show(method, steps)
    keep(record, options.json)


def run(step: str, *arguments: str) -> str:
    """Run `step` in a separate process and return its measurements."""
    command = [sys.executable, "-m", "benchmarks.scale", "--worker", step, *arguments]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


def show(method: str, steps: dict[str, dict[str, Any]]) -> None:
    """Print the rows of one method. Bytes per face are the growth of the process during the step."""
    first = steps["export"]
    asset = first["asset"] / first["faces"]
    print(f"{method:<24}{first['faces']:,} faces, asset {asset:.0f} bytes a face")
    for step, found in steps.items():
        if "unsupported" in found:
            print(f"{'':<24}{step:<11}{'N/A':>8}")
            continue
        high, own = found["peak"], found["private"]
        a_face, private = ((value - found["before"]) / found["faces"] for value in (high, own))
        row = f"{found['seconds']:>8.1f}{high / 1e9:>9.2f}{own / 1e9:>12.2f}{a_face:>8.0f}{private:>9.0f}"
        print(f"{'':<24}{step:<11}{row}", flush=True)
    if "weigh" in steps and "by NumPy" in steps:
        ratio = steps["by NumPy"]["seconds"] / steps["weigh"]["seconds"]
        print(f"{'':<24}face weights take 1/{ratio:.0f} of the time of NumPy", flush=True)


if __name__ == "__main__":
    main()
