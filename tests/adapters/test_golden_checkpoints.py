"""Real files, without torch: those torch wrote for us, and the four methods' golden checkpoints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.adapters.checkpoint import read_checkpoint
from tests.adapters.describe import assert_same_arrays, describe

GOLDEN = Path(__file__).parent.parent / "golden" / "checkpoints"
FILES = sorted(path.name for path in GOLDEN.glob("*.pt"))

# --- files of torch 2.13 (tests/adapters/torch_samples.py)


@pytest.mark.parametrize("file", FILES)
def test_a_file_of_torch_holds_what_torch_says(file: str) -> None:
    sample = file.rpartition("_")[0]
    expected = json.loads((GOLDEN / "expected.json").read_text())[sample]
    found: list[np.ndarray] = []
    assert describe(read_checkpoint(GOLDEN / file), found) == expected
    with np.load(GOLDEN / "expected.npz") as kept:
        assert_same_arrays(found, [kept[f"{sample}/{i}"] for i in range(len(found))])


def test_the_kept_files_are_small_and_of_all_layouts() -> None:
    assert len(FILES) >= 20
    assert {name.rpartition("_")[2] for name in FILES} == {
        *("zip2.pt", "zip3.pt", "zip4.pt", "legacy2.pt", "legacy4.pt")
    }
    assert sum(path.stat().st_size for path in GOLDEN.iterdir()) < 200_000


# --- the methods' files. N, V, F, K: triangles, vertices, faces, SH coefficients after the first.

SPLAT = {
    "triangles_points": ("float32", "V", 3),
    "_triangle_indices": ("int32", "F", 3),
    "vertex_weight": ("float32", "V", 1),
    "sigma": float,
    "active_sh_degree": int,
    "features_dc": ("float32", "V", 1, 3),
    "features_rest": ("float32", "V", "K", 3),
    "importance_score": ("float32", "F"),
    "image_size": ("float32", "F"),
    "pixel_count": ("int32", "F"),
}
OLDER_SPLAT = {key: value for key, value in SPLAT.items() if key != "pixel_count"}
TRIANGLES = {
    "triangles_points": ("float32", "N", 3, 3),
    "sigma": ("float32", "N", 1),
    "active_sh_degree": int,
    "features_dc": ("float32", "N", 1, 3),
    "features_rest": ("float32", "N", "K", 3),
    "opacity": ("float32", "N", 1),
}
HYPERPARAMETERS = {
    "max_radii2D": ("float32", "N"),
    "denom": ("float32", "N", 1),
    "spatial_lr_scale": float,
    "num_points_per_triangle": ("int32", "N"),
    "cumsum_of_points_per_triangle": ("int32", "N"),
    "number_of_points": int,
    "max_scaling": ("float32", "N"),
    "max_density_factor": ("float32", "N"),
}
PARAMS = {
    "_vertex": ("float32", "N", 3, 3),
    "_opacity": ("float32", "N", 1),
    "_f_dc": ("float32", "N", 1, 3),
    "_f_rest": ("float32", "N", "K", 3),
}
MLP = {
    "mlp.0.weight": ("float32", 16, 16),
    "mlp.0.bias": ("float32", 16),
    "mlp.2.weight": ("float32", 16, 16),
    "mlp.2.bias": ("float32", 16),
    "mlp.4.weight": ("float32", 3, 16),
    "mlp.4.bias": ("float32", 3),
}
SOUP = {
    "feat_acc": ("float32", "F", "S", 7),
    "alpha_acc": ("float32", "F", "S", 1),
    "V": ("float32", "V", 3),
    "F": ("int32", "F", 3),
    "color_mlp": dict,
    **dict.fromkeys(("Rmin", "Rmax", "feat_dim"), int),
    "K": ("float32", 3, 3),
    **dict.fromkeys(("H", "W"), int),
    "flip_z": bool,
    "steps": int,
    "losses": list,
    "seed": int,
}
SYNTHETIC_SOUP = {key: value for key, value in SOUP.items() if key not in ("K", "flip_z")}


def assert_table(value: dict[str, Any], table: dict[str, Any]) -> dict[str, int]:
    """Check keys in order, types and shapes against the table of the spec; return the letters' values."""
    letters: dict[str, int] = {}
    assert list(value) == list(table)
    for key, wanted in table.items():
        if isinstance(wanted, type):
            assert type(value[key]) is wanted, key
            continue
        dtype, *shape = wanted
        assert value[key].dtype == dtype
        assert value[key].ndim == len(shape)
        for length, letter in zip(value[key].shape, shape, strict=True):
            assert length == (letters.setdefault(letter, length) if isinstance(letter, str) else letter), key
    return letters


def checkpoints(shared: Path, pattern: str, least: int) -> list[Path]:
    paths = sorted((shared / "golden").glob(pattern))
    if not paths:
        pytest.skip(f"the shared data folder has no {pattern}")
    assert len(paths) >= least
    return paths


def test_mesh_splatting(shared: Path) -> None:
    for path in checkpoints(shared, "mesh_splatting/*/checkpoint*/**/point_cloud_state_dict.pt", 4):
        value = read_checkpoint(path)
        sizes = assert_table(value, OLDER_SPLAT if "older" in str(path) else SPLAT)
        assert sizes["K"] in (0, 15)
        assert 0 <= value["_triangle_indices"].min() <= value["_triangle_indices"].max() < sizes["V"]


def test_triangle_splatting(shared: Path) -> None:
    for path in checkpoints(shared, "triangle_splatting/*/checkpoint/**/point_cloud_state_dict.pt", 4):
        sizes = assert_table(read_checkpoint(path), TRIANGLES)
        more = read_checkpoint(path.with_name("hyperparameters.pt"))
        assert assert_table(more, HYPERPARAMETERS)["N"] == sizes["N"] == more["number_of_points"]
        # A view on the first N of N + 1 elements.
        np.testing.assert_array_equal(more["cumsum_of_points_per_triangle"], 3 * np.arange(sizes["N"]))


def test_two_dts(shared: Path) -> None:
    for path in checkpoints(shared, "two_dts/*/checkpoint/ckpt/*.ckpt", 3):
        value = read_checkpoint(path)
        assert type(value) is tuple
        params, optimizer, box, gamma = value
        assert type(params) is dict
        assert assert_table(params, PARAMS)["K"] in (0, 3, 8, 15)
        assert list(optimizer) == ["state", "param_groups"]
        for state in optimizer["state"].values():
            assert list(state) == ["step", "exp_avg", "exp_avg_sq"]
            assert state["step"].shape == ()
        assert set(optimizer["state"]) <= set(range(len(params)))
        assert box is None or len(box) in (4, 6)
        assert type(gamma) is float


def test_diffsoup(shared: Path) -> None:
    for path in checkpoints(shared, "diffsoup/*/checkpoint/final_params.pt", 3):
        value = read_checkpoint(path)
        sizes = assert_table(value, SOUP if "flip_z" in value else SYNTHETIC_SOUP)
        assert_table(value["color_mlp"], MLP)
        side = 2 ** value["Rmax"]
        assert sizes["S"] == (side + 1) * (side + 2) // 2
        assert all(type(loss) is float for loss in value["losses"])
