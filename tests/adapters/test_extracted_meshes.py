"""Methods that leave a mesh are known by its file's name, in the folders that their code writes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import msb
from data_stubs.made_meshes import PLACES
from msb.adapters.exporter import detect
from msb.api.inputs import expand
from msb.asset.texture import is_textured
from msb.errors import CheckpointError
from tests.tiny import MODELS

PEBBLE = MODELS / "pebble"
MADE = msb.open(PEBBLE / "milo")


@pytest.mark.parametrize("method", PLACES)
def test_folder_and_file_are_that_method_and_show_the_surface(method: str) -> None:
    folder, file = PEBBLE / method, PEBBLE / method / PLACES[method]
    asset = msb.open(folder)
    assert asset.manifest.method == method == detect(file) == detect(file.parent)
    np.testing.assert_allclose(asset.buffers["positions"], MADE.buffers["positions"], atol=1e-6)
    assert is_textured(asset) is (file.suffix == ".obj")
    assert expand(folder) == [folder]  # one model, not a folder of meshes
    found = msb.open(file).manifest.source.files
    assert found == asset.manifest.source.files
    assert found[0].path == PLACES[method]
    assert asset.audit().counts.faces == MADE.audit().counts.faces


def test_what_the_training_says_of_background_split_and_up_is_kept() -> None:
    manifest = msb.open(PEBBLE / "gaussian_wrapping").manifest
    assert manifest.appearance["background"] == "#ffffff"
    assert manifest.training == {"eval": True, "images": "images", "resolution": -1}
    assert "background" not in msb.open(PEBBLE / "trisplat").manifest.appearance


@pytest.mark.parametrize(
    ("names", "best"),
    [
        (("mesh_integration_sdf.ply", "mesh_learnable_sdf.ply"), "mesh_learnable_sdf.ply"),
        (("mesh_regular_tsdf_res512.ply", "mesh_regular_tsdf_res1024.ply"), "mesh_regular_tsdf_res1024.ply"),
        (("mesh_ours_2pivots.ply", "mesh_ours_2pivots_post.ply"), "mesh_ours_2pivots.ply"),
        (
            (
                "mesh_exact_computation_2pivots_searched.ply",
                "mesh_exact_computation_2pivots_searched_post.ply",
            ),
            "mesh_exact_computation_2pivots_searched.ply",
        ),
        (
            ("mesh/DIRECT_triangle_mesh.ply", "mesh/DIRECT_triangle_mesh_post.ply"),
            "mesh/DIRECT_triangle_mesh_post.ply",
        ),
    ],
)
def test_of_several_the_best_is_taken_beside_the_gaussians(
    tmp_path: Path, names: tuple[str, ...], best: str
) -> None:
    for name in (*names, "point_cloud/iteration_30000/point_cloud.ply"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PEBBLE / "milo" / PLACES["milo"], tmp_path / name)
    assert msb.open(tmp_path).manifest.source.files[0].path == best


def test_of_meshes_of_one_rank_one_is_to_be_given(tmp_path: Path) -> None:
    source = PEBBLE / "sugar" / PLACES["sugar"]
    for name in ("sugarfine_level01.obj", "sugarfine_level03.obj"):
        shutil.copy(source, tmp_path / name)
    with pytest.raises(CheckpointError, match=r"\(sugarfine_level01.obj, "):
        msb.open(tmp_path)


def test_a_mesh_of_another_name_is_taken_as_the_method_that_is_named(tmp_path: Path) -> None:
    shutil.copy(PEBBLE / "milo" / PLACES["milo"], tmp_path / "Barn.ply")
    assert msb.open(tmp_path / "Barn.ply").manifest.method == "mesh"
    assert msb.open(tmp_path / "Barn.ply", method="milo").manifest.method == "milo"
