"""Small valid models of each method, as values and as folders, which tests change."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from data_stubs.torch_file import write_torch
from msb.adapters.locate import STATE_DICT
from msb.methods.diffsoup.adapter_web import WEIGHTS, texture_size
from msb.registry import METHODS
from tests.conftest import ROOT

GOLDEN = ROOT / "tests" / "golden"
RANDOM = np.random.default_rng(3)
DECODER = {
    "mlp.0.weight": (16, 16),
    "mlp.0.bias": (16,),
    "mlp.2.weight": (16, 16),
    "mlp.2.bias": (16,),
    "mlp.4.weight": (3, 16),
    "mlp.4.bias": (3,),
}


def _normal(*shape: int) -> Any:
    return RANDOM.normal(size=shape).astype(np.float32)


def two_dts(count: int = 5, coefficients: int = 15) -> dict[str, Any]:
    return {
        "_vertex": _normal(count, 3, 3),
        "_opacity": _normal(count, 1),
        "_f_dc": _normal(count, 1, 3),
        "_f_rest": _normal(count, coefficients, 3),
    }


def triangle_splatting(count: int = 5, coefficients: int = 15) -> dict[str, Any]:
    return {
        "triangles_points": _normal(count, 3, 3),
        "sigma": _normal(count, 1),
        "active_sh_degree": 2,
        "features_dc": _normal(count, 1, 3),
        "features_rest": _normal(count, coefficients, 3),
        "opacity": _normal(count, 1),
    }


def mesh_splatting(vertices: int = 6, faces: int = 5, coefficients: int = 8) -> dict[str, Any]:
    return {
        "triangles_points": _normal(vertices, 3),
        "_triangle_indices": RANDOM.integers(0, vertices, (faces, 3)).astype(np.int32),
        "vertex_weight": _normal(vertices, 1),
        "sigma": -3.0,
        "active_sh_degree": 1,
        "features_dc": _normal(vertices, 1, 3),
        "features_rest": _normal(vertices, coefficients, 3),
        "importance_score": _normal(faces),
        "image_size": _normal(faces),
        "pixel_count": np.ones(faces, np.int32),
    }


def diffsoup(faces: int = 4, level: int = 1) -> dict[str, Any]:
    samples = (2**level + 1) * (2**level + 2) // 2
    return {
        "feat_acc": RANDOM.random((faces, samples, 7)).astype(np.float32),
        "alpha_acc": RANDOM.random((faces, samples, 1)).astype(np.float32),
        "V": _normal(3 * faces, 3),
        "F": np.arange(3 * faces, dtype=np.int32).reshape(-1, 3)[:, ::-1].copy(),
        "color_mlp": {key: _normal(*shape) for key, shape in DECODER.items()},
        "Rmin": 0,
        "Rmax": level,
        "feat_dim": 7,
        "H": 10,
        "W": 20,
        "flip_z": True,
    }


VALUES = {
    "two_dts": two_dts,
    "triangle_splatting": triangle_splatting,
    "mesh_splatting": mesh_splatting,
    "diffsoup": diffsoup,
}


def place(method: str) -> str:
    """Return the path of the model in an output folder of `method`."""
    files = METHODS[method].files or (f"point_cloud/iteration_{{n}}/{STATE_DICT}",)
    return files[0].format(n=30000)


def write_model(folder: Path, method: str, values: Any) -> Path:
    """Write `values` as the output folder of a training of `method`; return the folder."""
    file = folder / place(method)
    file.parent.mkdir(parents=True, exist_ok=True)
    if method == "two_dts" and isinstance(values, dict):
        values = (values, {}, None, 1.0)
    write_torch(file, values)
    return folder


def write_web_export(folder: Path, faces: int = 4, level: int = 1) -> Path:
    """Write a DiffSoup web export; return the folder."""
    from msb.meshes.files import write_mesh
    from msb.meshes.mesh import Mesh

    folder.mkdir(parents=True, exist_ok=True)
    samples = (2**level + 1) * (2**level + 2) // 2
    corners = np.arange(3 * faces, dtype=np.int64).reshape(-1, 3)
    write_mesh(Mesh(_normal(3 * faces, 3), corners, None, None), folder / "mesh.ply", suffix=".ply")
    width, height = texture_size(faces * samples)
    for name in ("lut0.png", "lut1.png"):
        pixels = RANDOM.integers(0, 256, (height, width, 4)).astype(np.uint8)
        Image.fromarray(pixels).save(folder / name)
    weights = {key: _normal(*DECODER[name]).ravel().tolist() for key, name in WEIGHTS.items()}
    (folder / "mlp_weights.json").write_text(json.dumps(weights))
    meta = {"up": [0, 0, 1], "level": level, "background": [1, 1, 1], "num_faces": faces}
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder
