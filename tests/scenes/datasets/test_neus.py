"""cameras.npz: decomposition against OpenCV's, and against the COLMAP model of the same cameras."""

import json
import shutil

import numpy as np
import pytest

from msb.errors import SceneError
from msb.scenes.datasets import read_matrices, read_scene
from msb.scenes.datasets.neus import decompose
from tests.conftest import ROOT

from .conftest import STUBS, Copy

GOLDEN = ROOT / "tests/golden/metrics/dtu_cull"


def test_golden_projections_are_decomposed() -> None:
    golden = json.loads((GOLDEN / "cameras_decomposed.json").read_text())
    with np.load(GOLDEN / "cull.npz") as file:
        matrices = {key: file[key].astype(np.float64) for key in file if "_mat_" in key}
    assert len(golden["views"]) == 4
    for view in golden["views"]:
        index = view["view"]
        lens, pose = decompose(matrices[f"world_mat_{index}"] @ matrices[f"scale_mat_{index}"])
        np.testing.assert_allclose(lens, view["K"], atol=golden["tolerance"]["K_abs"])
        np.testing.assert_allclose(
            np.linalg.inv(pose),  # noqa: TID251
            view["cam_to_world"],
            atol=golden["tolerance"]["pose_abs"],
        )
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_a_projection_is_defined_up_to_a_factor(sign: int, scale: float) -> None:
    lens = np.array([[900.0, 0.3, 400], [0, 880, 290], [0, 0, 1]])
    q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    rotation = q * np.sign(np.linalg.det(q))
    shift = np.array([0.3, -2, 5])
    projection = np.eye(4)
    projection[:3] = sign * scale * lens @ np.column_stack([rotation, shift])
    decomposed, pose = decompose(projection)
    np.testing.assert_allclose(decomposed, lens, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(pose[:3], np.column_stack([rotation, shift]), rtol=1e-9, atol=1e-9)


def test_a_singular_projection_is_rejected() -> None:
    flat = np.eye(4)
    flat[2] = flat[1]
    for matrix in (flat, np.zeros((4, 4)), np.full((4, 4), 1e300), np.full((4, 4), np.inf)):
        with pytest.raises(SceneError, match="SCENE_LAYOUT"):
            decompose(matrix)


def test_without_a_colmap_model_the_matrices_give_the_same_cameras(copy: Copy) -> None:
    root = copy("dtu/scan1")
    with_model = read_scene(root)
    shutil.rmtree(root / "sparse")
    scene = read_scene(root)
    assert (scene.layout, scene.dataset, scene.mask_source) == ("neus", "dtu", "png_alpha")
    assert [c.name for c in scene.test] == [c.name for c in with_model.test]
    for ours, theirs in zip(scene.train, with_model.train, strict=True):  # float32 in the file
        np.testing.assert_allclose(ours.world_to_camera, theirs.world_to_camera, atol=1e-5)
        np.testing.assert_allclose(ours.K, theirs.K, atol=1e-3)


def test_matrices_lead_to_millimetres() -> None:
    world, scale = read_matrices(STUBS / "dtu/scan1/cameras.npz")
    assert len(world) == len(scale) == 16
    np.testing.assert_allclose(scale[0], [[12, 0, 0, 5], [0, 12, 0, -3], [0, 0, 12, 600], [0, 0, 0, 1]])
