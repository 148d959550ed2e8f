"""Models of a known surface in the official file layouts of each method.

The models are not trained. Their appearance is computed from the surface, with the coverage and the noise of
the method. Triangles of soups overlap and have noisy colours. Blending averages these colours, but a depth
buffer does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_stubs.torch_file import write_torch
from msb.asset.sh import SH_C0
from msb.registry import BUILT_IN, METHODS

if TYPE_CHECKING:
    from data_stubs.surface import Surface

    Array = NDArray[np.float32]

TRAINED = tuple(name for name in BUILT_IN if METHODS[name].native is not None)
"""Methods with their own representation; this module creates a model of each."""
SH_C1 = 0.4886025119029199
NOISE = 0.06
"""Standard deviation of a triangle's colour; blending averages the colours of about twelve triangles."""
SPREAD = 0.03
"""Standard deviation of a triangle's offset along its normal, in units of its longest edge."""


def write_models(folder: Path, surface: Surface, *, white: bool, layout: str) -> None:
    """Write a model of every method below `folder`; `layout` is DiffSoup's layout, colmap or synthetic."""
    for method in TRAINED:
        (folder / method).mkdir(parents=True, exist_ok=True)
        _WRITERS[method](folder / method, surface, white, layout)


def _two_dts(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    corners, color, gloss = _soup(surface, 0.88, 0)
    params = {
        "_vertex": corners,
        "_opacity": np.full((len(corners), 1), 3.0, np.float32),
        "_f_dc": _f_dc(color),
        "_f_rest": _f_rest(gloss, surface.light),
    }
    (folder / "ckpt").mkdir(exist_ok=True)
    write_torch(folder / "ckpt" / "30000.ckpt", (params, {}, None, 1.0), "30000")
    background = "white" if white else "black"
    config = f"model:\n  rasterizer_type: 2D\n  max_sh_degree: 1\ntrainer:\n  eval_background: {background}\n"
    (folder / "config.yaml").write_text(config)


def _triangle_splatting(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    corners, color, gloss = _soup(surface, 1.7, 1)
    values = {
        "triangles_points": corners,
        "sigma": np.full((len(corners), 1), math.log(0.3), np.float32),
        "active_sh_degree": 1,
        "features_dc": _f_dc(color),
        "features_rest": _f_rest(gloss, surface.light),
        "importance_score": np.ones(len(corners), np.float32),
        "opacity": np.full((len(corners), 1), 2.5, np.float32),
    }
    _write_state_dict(folder, values, white)


def _mesh_splatting(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    values = _connected(surface)
    counts = np.full(len(surface.faces), 100, np.int32)
    _write_state_dict(folder, {**values, "pixel_count": counts}, white)


def _triangle_splatting_plus(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    _write_state_dict(folder, _connected(surface), white)


def _connected(surface: Surface) -> dict[str, Any]:
    random, faces = np.random.default_rng(2), len(surface.faces)
    color = surface.color + random.normal(0, 0.02, surface.color.shape)
    return {
        "triangles_points": surface.vertices.astype(np.float32),
        "_triangle_indices": surface.faces.astype(np.int32),
        "vertex_weight": random.normal(6.0, 1.0, (len(color), 1)).astype(np.float32),
        "sigma": math.log(1e-4),
        "active_sh_degree": 1,
        "features_dc": _f_dc(color),
        "features_rest": _f_rest(surface.gloss, surface.light),
        "importance_score": np.ones(faces, np.float32),
        "image_size": np.full(faces, 20, np.float32),
    }


def _diffsoup(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    """A lattice of level 0: one sample at each corner, in the order of corners 2, 0, 1.

    Features 0 to 2 are the base colour f. At places with sheen, feature 3 (f3) blends f with y =
    sigmoid(slope d . light). The decoder computes y, and d points to the camera. f is chosen so that (1 - f3)
    f + f3 y equals color + gloss (-d . light) near d . light = 0.
    """
    random, corners = np.random.default_rng(3), surface.faces[:, [2, 0, 1]]
    blend = 0.3 * (surface.gloss > 0)
    base = (surface.color - 0.5 * blend[:, None]) / (1 - blend[:, None])
    base += random.normal(0, 0.02, base.shape)
    rest = np.full((len(base), 3), 0.5)
    features = np.clip(np.concatenate([base, blend[:, None], rest], axis=1), 0, 1)
    slope = -4 * float(surface.gloss.max()) / 0.3  # the sigmoid's derivative at 0 is 1/4
    # Inputs 8 to 10 are -C1 y, C1 z and -C1 x of the direction to the camera.
    x, y, z = slope * surface.light / SH_C1
    first, second, last = np.zeros((16, 16)), np.zeros((16, 16)), np.zeros((3, 16))
    first[0, 8:11] = -y, z, -x
    first[1] = -first[0]
    second[:2, :2] = np.eye(2)
    last[:, :2] = 1, -1  # relu(t) - relu(-t) = t
    decoder = {"mlp.0.weight": first, "mlp.0.bias": np.zeros(16), "mlp.2.weight": second}
    decoder |= {"mlp.2.bias": np.zeros(16), "mlp.4.weight": last, "mlp.4.bias": np.zeros(3)}
    values = {
        "feat_acc": features[corners].astype(np.float32),
        "alpha_acc": np.ones((len(corners), 3, 1), np.float32),
        "V": surface.vertices.astype(np.float32),
        "F": surface.faces.astype(np.int32),
        "color_mlp": {key: value.astype(np.float32) for key, value in decoder.items()},
        "Rmin": 0,
        "Rmax": 0,
        "feat_dim": 7,
        "H": 192,
        "W": 256,
        **({"flip_z": True} if layout == "colmap" else {}),
        "steps": 1000,
    }
    write_torch(folder / "final_params.pt", values, "final_params")


def _three_dgs(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    _write_gaussians(folder, surface, 3, white)


def _two_dgs(folder: Path, surface: Surface, white: bool, layout: str) -> None:
    _write_gaussians(folder, surface, 2, white)


def _write_gaussians(folder: Path, surface: Surface, axes: int, white: bool) -> None:
    """Write a Gaussian for each face: flat, in its plane, with noisy colours that blending averages."""
    random = np.random.default_rng(4)
    corners = surface.vertices[surface.faces]
    first = corners[:, 1] - corners[:, 0]
    normal = np.cross(first, corners[:, 2] - corners[:, 0])
    edge = np.linalg.norm(first, axis=1, keepdims=True)
    first, normal = first / edge, normal / np.linalg.norm(normal, axis=1, keepdims=True)
    # Quaternions w, x, y, z of the rotations whose columns are an edge, the direction across it, the normal.
    matrix = np.stack([first, np.cross(normal, first), normal], axis=2)
    scale = np.log(np.concatenate([0.45 * edge, 0.45 * edge, 0.05 * edge], axis=1))[:, :axes]
    color = surface.color[surface.faces].mean(axis=1) + random.normal(0, NOISE, (len(edge), 3))
    rest = _f_rest(surface.gloss[surface.faces].mean(axis=1), surface.light)
    columns = [corners.mean(axis=1), np.zeros((len(edge), 3)), _f_dc(color)[:, 0]]
    columns += [rest.transpose(0, 2, 1).reshape(-1, 9), np.full((len(edge), 1), 2.0), scale]
    values = np.concatenate([*columns, _quaternions(matrix)], axis=1).astype("<f4")
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    names += [*(f"f_rest_{k}" for k in range(9)), "opacity", *(f"scale_{k}" for k in range(axes))]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(values)}"]
    lines += [f"property float {name}" for name in (*names, *(f"rot_{k}" for k in range(4)))]
    model = folder / "point_cloud" / "iteration_30000"
    model.mkdir(parents=True, exist_ok=True)
    (model / "point_cloud.ply").write_bytes("\n".join([*lines, "end_header\n"]).encode() + values.tobytes())
    _write_arguments(folder, white)


def _quaternions(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (n, 4) of rotation matrices (n, 3, 3), from the largest of four candidates each."""
    trace = np.stack([matrix[:, k, k] for k in range(3)], axis=1)
    turns = matrix - matrix.transpose(0, 2, 1)
    turn = np.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], axis=1)
    sums = matrix + matrix.transpose(0, 2, 1)
    # Candidate k (n, 4, 4) is four times component k times the quaternion.
    found = np.zeros((len(matrix), 4, 4))
    found[:, 0, 0] = 1 + trace.sum(axis=1)
    found[:, 0, 1:] = found[:, 1:, 0] = turn
    found[:, 1:, 1:] = sums
    for k in range(3):
        found[:, k + 1, k + 1] = 1 + 2 * trace[:, k] - trace.sum(axis=1)
    best = np.einsum("nkk->nk", found).argmax(axis=1)
    chosen = np.take_along_axis(found, best[:, None, None], axis=1)[:, 0]
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


_WRITERS: dict[str, Callable[[Path, Surface, bool, str], None]] = {
    "two_dts": _two_dts,
    "triangle_splatting": _triangle_splatting,
    "mesh_splatting": _mesh_splatting,
    "triangle_splatting_plus": _triangle_splatting_plus,
    "diffsoup": _diffsoup,
    "two_dgs": _two_dgs,
    "three_dgs": _three_dgs,
}


def _soup(
    surface: Surface, scale: float, seed: int
) -> tuple[Array, NDArray[np.float64], NDArray[np.float64]]:
    """Return corners (F, 3, 3), colours (F, 3) and gloss (F,) of free triangles, enlarged by `scale`."""
    random = np.random.default_rng(seed)
    corners = surface.vertices[surface.faces]
    middle = corners.mean(axis=1, keepdims=True)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    lift = (SPREAD * edge * random.normal(size=len(corners)))[:, None] * normal
    corners = middle + scale * (corners - middle) + lift[:, None]
    color = surface.color[surface.faces].mean(axis=1) + random.normal(0, NOISE, (len(corners), 3))
    return corners.astype(np.float32), color, surface.gloss[surface.faces].mean(axis=1)


def _f_dc(color: NDArray[np.float64]) -> Array:
    return ((color - 0.5) / SH_C0).astype(np.float32)[:, None]


def _f_rest(gloss: NDArray[np.float64], light: NDArray[np.float64]) -> Array:
    """Return the SH coefficients (n, 3, 3) of gloss d . light, where d points away from the camera."""
    x, y, z = light / SH_C1
    per_unit = np.repeat(np.array([-y, z, -x])[:, None], 3, axis=1)
    return (gloss[:, None, None] * per_unit).astype(np.float32)


def _write_state_dict(folder: Path, values: dict[str, Any], white: bool) -> None:
    model = folder / "point_cloud" / "iteration_30000"
    model.mkdir(parents=True, exist_ok=True)
    write_torch(model / "point_cloud_state_dict.pt", values, "point_cloud_state_dict")
    _write_arguments(folder, white)


def _write_arguments(folder: Path, white: bool) -> None:
    arguments = (
        "sh_degree=1, source_path='data/pebble', model_path='output/pebble', images='images', resolution=-1, "
        f"white_background={white}, data_device='cuda', eval=True"
    )
    (folder / "cfg_args").write_text(f"Namespace({arguments})")
