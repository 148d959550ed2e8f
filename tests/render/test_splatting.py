"""The splatting pipeline against the NumPy reference on random models, and limit cases."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset
from msb.cl import Device
from msb.reference import render_reference
from msb.reference.camera_matrices import splatting_camera
from msb.reference.edge_window import FAR, NEAR, project_windows
from msb.render.dedicated import dedicated_renderer
from msb.render.frame import Frame
from msb.render.splat import view as splat_view
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera
from tests.cl.conftest import SELECTOR, open_styled
from tests.reference import test_properties
from tests.reference.soups import SPLATTING, front_camera, random_triangles, soup
from tests.render.frames import assert_near, frame_of

VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("two_dts", {}),
    ("two_dts", {"sh_degree": 1, "gamma": 7.5, "back_culling": True, "gamma_rescale": True}),
    ("two_dts", {"gamma": 50.0, "ste_threshold": 0.4, "render_up_scale": 2, "sh_degree": 0}),
    ("two_dts", {"rasterizer": "3D", "render_up_scale": 3, "sh_degree": 2}),
    ("two_dts", {"rasterizer": "3D", "gamma": 30.0, "back_culling": True, "render_up_scale": 4}),
    ("triangle_splatting", {}),
    ("triangle_splatting", {"view_dir": "centroid", "sh_degree": 2}),
    ("mesh_splatting", {"opacity_floor": 0.0, "sigma": 0.3, "supersample": 1}),
    ("mesh_splatting", {"opacity_floor": 0.1, "sigma": 2.0, "supersample": 3, "sh_degree": 1}),
    ("mesh_splatting", {}),
]
variants = pytest.mark.parametrize(("method", "settings"), VARIANTS)
methods = pytest.mark.parametrize("method", SPLATTING)


def all_sorts(seed: int) -> np.ndarray:
    """Return large, tiny, thin, edge-on, degenerate, duplicate, near and hidden triangles: (F, 3, 3)."""
    random = np.random.default_rng(seed)
    sizes = np.exp(random.uniform(np.log(0.004), np.log(3), 260))
    triangles = random_triangles(seed, 260, 1.0)
    center = triangles.mean(axis=1, keepdims=True)
    triangles = center + (triangles - center) * sizes[:, None, None]
    triangles[:30, :, 0] = center[:30, :, 0] + (triangles[:30, :, 0] - center[:30, :, 0]) * 0.01
    triangles[30:40, 2] = triangles[30:40, 1]
    triangles[40:60] = triangles[60:80]
    triangles[80:110, :, 2] -= random.uniform(2, 9, (30, 1))
    triangles[110:130, :, 2] = random.uniform(2, 3, (20, 1))
    return triangles.astype(np.float32)


def model(method: str, seed: int, degree: int = 3) -> Asset:
    random = np.random.default_rng(seed + 100)
    triangles = all_sorts(seed)
    count = len(triangles)
    rows = 3 * count if method == "mesh_splatting" else count
    buffers = {"opacity": random.normal(1, 3, rows).astype(np.float32)}
    buffers["opacity"][:4] = np.inf, -np.inf, np.inf, np.inf
    if method == "triangle_splatting":
        buffers["sigma"] = random.uniform(-9, 2.5, rows).astype(np.float32)
    return soup(method, triangles, seed=seed, degree=degree, **buffers)


def draw(
    asset: Asset,
    device: Device,
    camera: Camera,
    settings: dict[str, Any] | None = None,
    background: tuple[float, float, float] = (0.2, 0.7, 0.4),
    **options: Any,
) -> Frame:
    return frame_of(SplattingPipeline, asset, device, camera, background, settings=settings, **options)


@pytest.mark.slow
@variants
@pytest.mark.parametrize("seed", range(3))
def test_equals_the_reference(
    method: str, settings: dict[str, Any], seed: int, cpu: Device, gpu: Device
) -> None:
    asset = model(method, seed)
    camera = (front_camera(75, 53), front_camera(64, 48, cx=20.5, cy=31.25), front_camera(33, 50))[seed]
    wanted = render_reference(asset, camera, (0.2, 0.7, 0.4), settings)
    for device in (cpu, gpu):
        frame = draw(asset, device, camera, settings, outputs="all")
        assert_near(frame, wanted)
        assert (frame.normal is None) == (wanted.normal is None)
        if wanted.face_id is not None:
            assert (frame.face_id != wanted.face_id).mean() <= 2e-3


@test_properties.variants
def test_an_empty_view_is_background(method: str, settings: dict[str, Any], cpu: Device, gpu: Device) -> None:
    away = Camera(37, 23, 40, 40, 18.5, 11.5, np.diag([-1.0, 1, -1, 1]))
    asset, background = soup(method, random_triangles(2)), (0.25, 0.5, 0.75)
    options = {"settings": settings, "outputs": "all"}
    frames: list[Any] = [
        frame_of(dedicated_renderer, asset, device, away, background, **options) for device in (cpu, gpu)
    ]
    for frame in (*frames, render_reference(asset, away, background, settings)):
        assert (frame.image == np.float32(background)).all()
        assert not frame.visible.any()
        assert not frame.alpha.any()
        assert not frame.depth.any()
        assert frame.face_id is None or (frame.face_id == -1).all()
    for device in (cpu, gpu) if method in SPLATTING else ():
        with closing(SplattingPipeline(asset, device=device)) as pipeline:
            assert not pipeline.shares(away).any()


@pytest.mark.slow
@pytest.mark.parametrize(("method", "settings"), [VARIANTS[1], VARIANTS[4], VARIANTS[6], VARIANTS[8]])
def test_optimisations_change_no_pixel(
    method: str, settings: dict[str, Any], cpu: Device, gpu: Device
) -> None:
    asset, camera = model(method, 9), front_camera(71, 45)
    for device in (cpu, gpu):
        frame = draw(asset, device, camera, settings)
        plain = draw(asset, device, camera, settings, early_stop=False, exact_tiles=False)
        np.testing.assert_array_equal(plain.image, frame.image)
        np.testing.assert_array_equal(plain.depth, frame.depth)


@pytest.mark.slow
@pytest.mark.parametrize("style", ["cpu", "gpu"])
def test_depth_keys_and_sample_positions_are_the_official_bits(style: Any) -> None:
    """Depth keys decide the order of faces. Official sample positions are doubles, ours pairs of floats."""
    asset, camera = model("mesh_splatting", 8), front_camera(731, 533)
    with open_styled(style) as device:
        pipeline = SplattingPipeline(asset, device=device, settings={"supersample": 3})
        frame = pipeline.render(camera, (0.2, 0.7, 0.4))
        count = asset.manifest.face_count
        with pipeline._scope.turn():
            faces = pipeline._scratch("faces", (count, 40), np.float32).read()
            keys = pipeline._scratch("keys", count, np.float32).read()
            items = 1 if style == "cpu" else count
            listed = pipeline._scratch("listed", items, np.uint32).read()
    triangles = asset.buffers["positions"].reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        windows = project_windows(triangles, splatting_camera(camera, NEAR, FAR, np.float32, 3))
    assert listed.sum() > 50
    places = np.arange(listed[0]) if style == "cpu" else np.flatnonzero(listed)
    numbers = faces[places, 37].view(np.int32)
    assert frame.visible[numbers].all()
    np.testing.assert_array_equal(keys[places], windows.depth[numbers])
    np.testing.assert_array_equal(faces[places, 11:13], windows.corners[numbers, 0])
    np.testing.assert_array_equal(faces[places, 6:9], windows.edge_offset[numbers])


@pytest.mark.slow
@methods
@pytest.mark.parametrize("sampling", ["official", "engine"])
@pytest.mark.parametrize("offset", [0.0, 3000.0])
def test_bounding_spheres_drop_no_visible_face(
    method: str, sampling: Any, offset: float, cpu: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draw slivers, pixel-sized and huge faces all around the camera, near the origin and far from the
    origin.
    """
    random = np.random.default_rng(5)
    count = 30_000
    corners = random.normal(size=(count, 3, 3)) * np.exp(random.uniform(-7, 0, (count, 1, 3)))
    corners[:300] *= 20
    corners[300:400, 2] = corners[300:400, 0]
    triangles = (corners + random.normal(scale=4, size=(count, 1, 3)) + offset).astype(np.float32)
    window = {"sigma": np.zeros(count, np.float32)} if method == "triangle_splatting" else {}
    asset = soup(method, triangles, **window)
    turned = np.linalg.qr(random.normal(size=(3, 3)))[0]
    pose = np.eye(4)
    pose[:3, :3] = turned * np.sign(np.linalg.det(turned))
    pose[:3, 3] = -pose[:3, :3] @ np.full(3, offset)
    cameras = [Camera(80, 60, 70, 75, 35.5, 31, pose), Camera(50, 120, 400, 400, 25, 60, pose)]
    settings = {"supersample": 1} if method == "mesh_splatting" else {}
    frames = [draw(asset, cpu, camera, settings, sampling=sampling) for camera in cameras]
    no_limits = (-np.inf, 0, np.zeros(4), 1, np.inf, np.inf)  # infinite spheres are never culled
    monkeypatch.setattr(splat_view, "_limits", lambda *_: no_limits)
    for frame, camera in zip(frames, cameras, strict=True):
        everything = draw(asset, cpu, camera, settings, sampling=sampling)
        assert 20 < frame.visible.sum() < 0.5 * count
        np.testing.assert_array_equal(frame.visible, everything.visible)
        np.testing.assert_array_equal(frame.image, everything.image)


def test_timings_and_memory_by_use() -> None:
    pipeline = SplattingPipeline(model("two_dts", 1), device=SELECTOR)
    frame = pipeline.render(front_camera(), (0, 0, 0))
    stages = ("project", "sort", "bin", "blend", "resolve")
    assert tuple(frame.timings) == (*stages, "read")
    drawn = pipeline.draw(front_camera(), (0, 0, 0))
    assert tuple(drawn.stages) == stages
    assert drawn.span > 0
    held = pipeline.memory()
    assert held["positions"] == 260 * 36
    assert held["f_rest"] == 260 * 180
    lists = "splat tile lists" if pipeline._device.style == "cpu" else "splat pair places"
    assert {"splat faces", "splat planes", lists, "splat image"} <= held.keys()
    pipeline.close()
    pipeline.close()
