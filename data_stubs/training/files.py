"""Write the official files of each method without torch (see `data_stubs.torch_file`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_stubs.torch_file import write_torch
from msb.base.atomic import new_file

if TYPE_CHECKING:
    from data_stubs.training.scene import Capture


def write_state_dict(
    folder: Path, iteration: int, values: Mapping[str, Any], capture: Capture, degree: int
) -> None:
    """Write the output files of Triangle-Splatting or MeshSplatting."""
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
    place = folder / "point_cloud" / f"iteration_{iteration}"
    _torch(place / "point_cloud_state_dict.pt", dict(values), "point_cloud_state_dict")


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
