"""The demo scenes and models: size, number of views, quality, agreement with their script."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import msb
from data_stubs import captures, still_life
from data_stubs.made_models import TRAINED
from data_stubs.make import WORLD
from data_stubs.photographs import photograph, to_bytes
from msb import metrics
from msb.metrics.ground_truth import ground_truth
from msb.scenes.datasets import read_scene
from msb.scenes.datasets.read import scene_at
from tests.conftest import ROOT

STUBS = ROOT / "data_stubs"
MODELS = [(path.parent.name, path.name) for path in sorted((STUBS / "models").glob("*/*"))]
# The demo data lacks a model of Triangle Splatting+, which shares the renderer and layout of MeshSplatting.
# Methods of Gaussians have one model each.
METHODS = set(TRAINED) - {"triangle_splatting_plus"}
MAX_BYTES, MAX_BYTES_OF_GAUSSIANS = 8_500_000, {"three_dgs": 500_000, "two_dgs": 250_000}
MAX_FACES = 8000
MIN_PSNR = 28.0
SCENES = {"walled": "mipnerf360/pebble", "pebble": "nerf_synthetic/pebble"}


def test_demo_data_is_small() -> None:
    files = [path for path in STUBS.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert sum(path.stat().st_size for path in files) < MAX_BYTES


@pytest.mark.parametrize("dataset", captures.WRITERS)
def test_every_scene_has_at_least_24_views_and_eight_test_views(dataset: str) -> None:
    place = STUBS / "scenes" / captures.place_of(dataset, WORLD)
    scene = read_scene(
        place / "scan1" if dataset == "dtu" else place, resolution=1 if dataset == "dtu" else None
    )
    assert len(scene.train) + len(scene.test) >= 24
    assert len(scene.test) == 8
    sizes = {(camera.width, camera.height) for camera in (*scene.train, *scene.test)}
    assert sizes <= {(240, 180), (120, 120)}


def test_every_scene_has_a_model_of_every_method() -> None:
    of_gaussians = {("pebble", name) for name in MAX_BYTES_OF_GAUSSIANS}
    others = METHODS - set(MAX_BYTES_OF_GAUSSIANS)
    assert set(MODELS) == {(world, name) for world in SCENES for name in others} | of_gaussians
    for name, most in MAX_BYTES_OF_GAUSSIANS.items():
        files = (STUBS / "models" / "pebble" / name).rglob("*")
        assert sum(path.stat().st_size for path in files if path.is_file()) < most


@pytest.mark.slow
@pytest.mark.parametrize(("world", "method"), MODELS)
def test_every_model_is_trained_and_renders_test_views_well(world: str, method: str) -> None:
    folder = STUBS / "models" / world / method
    asset = msb.open(folder)
    assert asset.manifest.method == method
    assert asset.manifest.face_count <= MAX_FACES
    dataset = SCENES[world].split("/")[0]
    scene = scene_at(STUBS / "scenes" / SCENES[world], dataset, method).read()
    assert len(scene.test) == 8
    with msb.Renderer(asset, "dedicated") as renderer:
        psnr = [
            metrics.psnr(
                np.clip(renderer.render(camera, scene.background).image, 0, 1), ground_truth(scene, camera)
            )
            for camera in scene.test
        ]
    assert np.mean(psnr) >= MIN_PSNR
    training = json.loads((folder / "training.json").read_text())
    assert training["note"].startswith("optimised by our trainer")
    assert training["psnr"][-1]["psnr"] == pytest.approx(np.mean(psnr), abs=0.05)


@pytest.mark.slow
def test_photographs_equal_renderings_of_the_script() -> None:
    alone = captures.nerf_synthetic_cameras(WORLD)["test"][2]
    stored = _pixels(STUBS / f"scenes/nerf_synthetic/pebble/{alone.name}.png")
    rendered = captures.coarse(photograph(still_life.pebbles(), alone), WORLD.levels)
    assert np.abs(stored - to_bytes(rendered)).mean() < 0.1


def _pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


@pytest.mark.slow
def test_every_pebble_is_closed_and_one_is_a_torus() -> None:
    numbers = []
    for stone in still_life.PEBBLES:
        vertices, faces = still_life.surface_of(stone.distance)
        audit = msb.audit(vertices, faces).to_dict()
        assert audit["counts"]["boundary_edges"] == audit["counts"]["nonmanifold_edges"] == 0
        assert audit["counts"]["components"] == 1
        numbers.append(audit["metrics"]["euler_characteristic"])
    assert numbers == [2, 2, 2, 2, 0]
