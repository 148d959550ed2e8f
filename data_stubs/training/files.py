"""Write the official files of each method without torch (see `data_stubs.torch_file`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_stubs.torch_file import write_torch
from msb.base.atomic import new_file

if TYPE_CHECKING:
    from data_stubs.training.scene import Capture


def write_state_dict(
    folder: Path, iteration: int, values: Mapping[str, Any], capture: Capture, degree: int
) -> None:
    """Write the output files of Triangle-Splatting or MeshSplatting."""
    _write_arguments(folder, capture, degree)
    place = folder / "point_cloud" / f"iteration_{iteration}"
    _torch(place / "point_cloud_state_dict.pt", dict(values), "point_cloud_state_dict")


def write_gaussians(
    folder: Path, iteration: int, values: Mapping[str, Any], capture: Capture, degree: int
) -> None:
    """Write the output files of 3DGS, or of 2DGS, whose Gaussians have two scales."""
    _write_arguments(folder, capture, degree)
    count, rest = len(values["xyz"]), values["f_rest"].transpose(0, 2, 1)
    normals, color = np.zeros((count, 3)), values["f_dc"][:, 0]
    parts = [values["xyz"], normals, color, rest.reshape(count, -1)]
    parts += [values[name] for name in ("opacity", "scale", "rotation")]
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    names += [f"f_rest_{k}" for k in range(3 * rest.shape[2])]
    names += [
        "opacity",
        *(f"scale_{k}" for k in range(values["scale"].shape[1])),
        *(f"rot_{k}" for k in range(4)),
    ]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [*(f"property float {name}" for name in names), "end_header\n"]
    with new_file(folder / "point_cloud" / f"iteration_{iteration}" / "point_cloud.ply") as file:
        file.write("\n".join(lines).encode())
        file.write(np.concatenate(parts, axis=1).astype("<f4").tobytes())


def _write_arguments(folder: Path, capture: Capture, degree: int) -> None:
    """Write `cfg_args`, the arguments of a training of the 3DGS family."""
    arguments = {
        "sh_degree": degree,
        **capture.about,
        "model_path": folder.name,
        "resolution": -1,
        "white_background": capture.white,
        "data_device": "cpu",
        "eval": True,
    }
    words = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
    _text(folder / "cfg_args", f"Namespace({words})")


def write_2dts(
    folder: Path,
    iteration: int,
    values: Mapping[str, Any],
    settings: Mapping[str, Any],
    capture: Capture,
) -> None:
    """Write 2DTS' checkpoint with its config."""
    names = ("_vertex", "_opacity", "_f_dc", "_f_rest")
    place = folder / "ckpt" / f"{iteration}.ckpt"
    checkpoint = ({name: values[name] for name in names}, {}, None, float(settings["gamma"]))
    _torch(place, checkpoint, str(iteration))
    model = {
        "rasterizer_type": settings["rasterizer"],
        "max_sh_degree": settings["sh_degree"],
        "gamma_rescale": str(settings["gamma_rescale"]).lower(),
        "back_culling": str(settings["back_culling"]).lower(),
    }
    lines = "".join(f"  {name}: {value}\n" for name, value in model.items())
    background = "white" if capture.white else "black"
    dataset = "NerfSynthetic" if capture.synthetic else "MipNerf360"
    trainer = f"  output_dir: outputs/{dataset}/VanillaTS\n  eval_background: {background}\n"
    _text(folder / "config.yaml", f"model:\n{lines}trainer:\n{trainer}")


def write_diffsoup(folder: Path, values: Mapping[str, Any]) -> None:
    """Write DiffSoup's file."""
    _torch(folder / "final_params.pt", dict(values), "final_params")


def _torch(path: Path, value: Any, root: str) -> None:
    with new_file(path) as file:
        write_torch(file, value, root)


def _text(path: Path, text: str) -> None:
    with new_file(path) as file:
        file.write(text.encode())
