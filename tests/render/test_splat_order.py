"""The order of faces on the device, their bounding spheres, and images that do not depend on the order."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.cl import Device
from msb.registry import Order
from msb.render.splat import order as splat_order
from msb.render.splat.bins import DepthSort, Projected
from msb.render.splat.pipeline import SplattingPipeline
from tests.reference.soups import SPLATTING, front_camera, soup
from tests.render.frames import assert_same

COUNT = 5003
BITS = 18
NUMBER_WORD = {"two_dts": 22, "triangle_splatting": 23, "mesh_splatting": 37}
"""For each method, the index of the word in a face record that holds the number of the face."""


def triangles_of_all_sizes(seed: int = 0) -> NDArray[np.float32]:
    """Return triangles (COUNT, 3, 3): one far away, one without extent, some identical."""
    random = np.random.default_rng(seed)
    corners = random.normal(size=(COUNT, 3, 3)) * np.exp(random.uniform(-8, 0, (COUNT, 1, 1)))
    triangles = corners + random.normal(scale=3, size=(COUNT, 1, 3))
    triangles[17] += 5000
    triangles[18] = triangles[18, :1]
    triangles[100:200] = triangles[200:300]
    return triangles.astype(np.float32)


@pytest.fixture(params=SPLATTING)
def pipeline(request: pytest.FixtureRequest, device: Device) -> Iterator[SplattingPipeline]:
    window = {"sigma": np.zeros(COUNT, np.float32)} if request.param == "triangle_splatting" else {}
    pipeline = SplattingPipeline(soup(request.param, triangles_of_all_sizes(), **window), device=device)
    pipeline._order_faces(at_frame=1)
    yield pipeline
    pipeline.close()


def interleave(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return keys of cells (n, 3) with interleaved bits, x lowest."""
    keys = np.zeros(len(cells), np.uint64)
    for bit in range(BITS):
        for axis in range(3):
            here = cells[:, axis] >> np.uint64(bit) & np.uint64(1)
            keys |= here << np.uint64(3 * bit + axis)
    return keys


def split_words(words: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the two numbers in each word: radius and inradius."""
    bits = words.view(np.uint32)
    return (bits & np.uint32(0xFFFF0000)).view(np.float32), (bits << np.uint32(16)).view(np.float32)


def curve(points: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Return the keys of points (n, 3) along the curve: the NumPy twin of splat_order.cl."""
    low, high = points.min(axis=0), points.max(axis=0)
    scale = np.float32(((1 << BITS) - 1) / (high.astype(np.float64) - low).max())
    return interleave(np.minimum((points - low) * scale, np.float32((1 << BITS) - 1)).astype(np.uint64))


@pytest.mark.slow
def test_rows_run_along_a_curve_through_space(pipeline: SplattingPipeline) -> None:
    kept = pipeline._static
    numbers = kept["numbers"].read()
    np.testing.assert_array_equal(np.sort(numbers), np.arange(COUNT))
    bounds = kept["bounds"].read()[:, :COUNT]
    keys = curve(bounds[:3].T)
    if not pipeline._model.vertex_colors:
        exponent = split_words(bounds[3])[1].view(np.uint32).astype(np.uint64) >> np.uint64(23)
        assert len(np.unique(exponent)) > 8
        keys |= exponent << np.uint64(3 * BITS)
    np.testing.assert_array_equal(np.lexsort((numbers, keys)), np.arange(COUNT))


@pytest.mark.slow
def test_models_are_not_sorted_for_few_frames(device: Device) -> None:
    asset = soup("mesh_splatting", triangles_of_all_sizes())
    with splat_order.few_frames(), closing(SplattingPipeline(asset, device=device)) as pipeline:
        pipeline._order_faces(at_frame=1)
        np.testing.assert_array_equal(pipeline._static["numbers"].read(), np.arange(COUNT))
        pipeline.render(front_camera(32, 24), (0.0, 0.0, 0.0))
        assert pipeline._sort.by_rows


def test_all_arrays_are_sorted_alike(pipeline: SplattingPipeline) -> None:
    kept, model = pipeline._static, pipeline._model
    numbers = kept["numbers"].read()
    rows, stored = numbers, model.positions.reshape(COUNT, 9)
    if model.vertex_colors:
        stored = model.positions
        rows = np.argsort(curve(stored), kind="stable")
        corners = stored[np.arange(3 * COUNT).reshape(-1, 3)[numbers]]
        np.testing.assert_array_equal(kept["positions"].read()[kept["indices"].read()], corners)
    np.testing.assert_array_equal(kept["positions"].read(), stored[rows])
    np.testing.assert_array_equal(kept["coverage"].read(), model.coverage[rows])


def test_spheres_contain_their_faces(pipeline: SplattingPipeline) -> None:
    kept = pipeline._static
    corners = triangles_of_all_sizes()[kept["numbers"].read()].astype(np.float64)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum(axis=1)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    inradius = doubled / np.maximum(sides, 1e-300)
    levels = {"bounds": 1, "groups": 64} if "groups" in kept else {"bounds": 1}
    for name, size in levels.items():
        spheres = kept[name].read()[:, : -(-COUNT // size)].repeat(size, axis=1)[:, :COUNT]
        radius, largest = split_words(spheres[3])
        distance = np.linalg.norm(corners - spheres[:3].T[:, None], axis=2).max(axis=1)
        noise = 1e-6 * np.abs(corners).max(axis=(1, 2))
        assert (distance <= radius + noise).all()
        assert (inradius <= largest + noise).all()
        if size == 1:
            assert (radius <= 1.02 * distance + noise).all()


@pytest.mark.parametrize("order", ["tile", "none"])
@pytest.mark.parametrize("different", [1, 40, 4000, 10**6])
def test_equal_depths_are_sorted_by_number(
    pipeline: SplattingPipeline, order: Order, different: int, device: Device
) -> None:
    """A run of equal depths has two faces, some faces, more faces than are sorted in place, or all faces."""
    random = np.random.default_rng(different)
    places = np.sort(random.choice(COUNT, 3001, replace=False)).astype(np.uint32)
    numbers = random.permutation(COUNT)
    depths = np.sqrt(random.integers(1, different + 1, COUNT)).astype(np.float32)
    records = np.zeros((COUNT, pipeline.record_words), np.uint32)
    records[:, NUMBER_WORD[pipeline._model.program.removeprefix("splat_")]] = numbers
    unused: Any = None
    projected = Projected(
        faces=device.upload(records),
        keys=device.upload(depths.view(np.uint32)),
        tiles=unused,
        listed=unused,
        visible=device.allocate(COUNT),
    )
    sort = DepthSort(device, pipeline._program, order)
    sort.by_rows = False
    keys = device.upload(depths[places].view(np.uint32))
    result = sort(projected, keys, device.upload(places.copy())).read()
    by_depth = np.zeros(len(places)) if order == "none" else depths[places]
    np.testing.assert_array_equal(result, places[np.lexsort((numbers[places], by_depth))])


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("options", [{}, {"order": "global"}, {"order": "none"}], ids=str)
def test_the_order_on_the_device_does_not_change_images(
    method: str, flat: bool, options: dict[str, Any], device: Device
) -> None:
    """Frames stay bit-identical, also if all faces are in a plane parallel to the image."""
    random = np.random.default_rng(3)
    triangles = triangles_of_all_sizes() + np.float32([0, 0, 5])
    if flat:
        triangles[..., 2] = 4
    rows = COUNT * (3 if method == "mesh_splatting" else 1)
    buffers = {"opacity": random.normal(1, 1, rows).astype(np.float32)}
    if method == "triangle_splatting":
        buffers["sigma"] = random.normal(0, 1, COUNT).astype(np.float32)
    pipeline = SplattingPipeline(soup(method, triangles, **buffers), device=device, outputs="all", **options)
    try:
        frames = [pipeline.render(front_camera(97, 61), (0.1, 0.2, 0.3)) for _ in range(4)]
    finally:
        pipeline.close()
    assert not pipeline._sort.by_rows
    assert frames[0].visible.sum() > 100
    for frame in frames[1:]:
        assert_same(frame, frames[0])


@pytest.mark.slow
def test_a_model_is_not_sorted_without_memory_for_a_copy(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipeline = SplattingPipeline(soup("two_dts", triangles_of_all_sizes()), device=device)
    first = pipeline.render(front_camera(), (0, 0, 0))
    held = pipeline.memory()
    monkeypatch.setattr(splat_order, "_MODEL_SHARE", 0)
    try:
        frames = [pipeline.render(front_camera(), (0, 0, 0)) for _ in range(3)]
        assert pipeline._sort.by_rows
        assert pipeline.memory().keys() - held.keys() == set()
        np.testing.assert_array_equal(frames[-1].image, first.image)
    finally:
        pipeline.close()
