"""DTU Chamfer distances against the reference script, stage by stage; MATLAB files against SciPy."""

import io
import shutil
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import loadmat, savemat
from scipy.spatial.distance import cdist

from msb import metrics
from msb.errors import InputError, MeshFileError, MetricError
from msb.meshes import read_mesh
from msb.metrics import sampling
from msb.metrics.matlab import find_variables
from msb.metrics.sampling import sample_surface, thin
from tests.metrics.conftest import DTU, golden

CASES = golden("dtu_synthetic/chamfer.json")["cases"]
RUNS = [(case, run) for case in CASES for run in case.get("runs", ())]
CLOUDS = [case for case in CASES if case["mode"] == "pcd"]


def scan_of(case: dict[str, Any]) -> int:
    return int(case["id"].removeprefix("scan").partition("_")[0])


def assert_is(result: dict[str, Any], expected: dict[str, Any]) -> None:
    for key, value in expected.items():
        if key in result and value is not None:
            assert result[key] == pytest.approx(value, abs=1e-12), key


@pytest.mark.parametrize(("case", "run"), RUNS, ids=[f"{c['id']}-{r['shuffle_seed']}" for c, r in RUNS])
def test_golden_meshes(case: dict[str, Any], run: dict[str, Any]) -> None:
    result = metrics.chamfer_dtu(DTU / case["mesh"], DTU, scan_of(case), seed=run["shuffle_seed"])
    assert_is(result, {**case["deterministic"], **run})
    assert result["overall"] == (result["mean_d2s"] + result["mean_s2d"]) / 2
    assert result["reason"] is None
    assert (result["scan"], result["seed"]) == (scan_of(case), run["shuffle_seed"])
    assert result["identity"]["parameters"]["seed"] == run["shuffle_seed"]


@pytest.mark.parametrize("case", CLOUDS, ids=lambda case: case["id"])
def test_golden_points(case: dict[str, Any]) -> None:
    data = metrics.read_dtu_scan(DTU, scan_of(case))
    cloud = read_mesh(DTU / case["points"])
    assert (len(cloud.faces), data.points.dtype) == (0, np.float64)
    points = cloud.vertices
    assert_is(metrics.chamfer_points(points, data), {**case["deterministic"], **case})
    shorter = metrics.chamfer_points(points, data, max_distance=1)
    assert_is(shorter, case["with_max_dist_1"])
    assert shorter["identity"]["parameters"]["max_distance_mm"] == 1


@pytest.mark.slow
def test_memory_bounds_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = read_mesh(DTU / "mesh2.ply")
    vertices, faces = mesh.vertices.astype(np.float64), mesh.faces
    whole, _ = sample_surface(vertices, faces, 0.2)
    thinned = thin(whole, 0.2)
    monkeypatch.setattr(sampling, "_CANDIDATES", 97)
    monkeypatch.setattr(sampling, "_WINDOW", 64)
    monkeypatch.setattr(sampling, "_NEIGHBORS", 50)
    assert np.array_equal(sample_surface(vertices, faces, 0.2)[0], whole)
    assert np.array_equal(thin(whole, 0.2), thinned)


def sample_by_loops(vertices: NDArray[Any], faces: NDArray[Any], spacing: float) -> list[NDArray[Any]]:
    samples = []
    for a, b, c in vertices[faces]:
        double_area = np.linalg.norm(np.cross(b - a, c - a))
        if double_area == 0:
            continue
        l1, l2 = np.linalg.norm(b - a), np.linalg.norm(c - a)
        step = spacing * np.sqrt(l1 * l2 / double_area)
        n1, n2 = int(l1 / step), int(l2 / step)
        for i in range(n1 + 1):
            for j in range(n2 + 1):
                if n1 and n2 and (i + 0.5) / n1 + (j + 0.5) / n2 < 1:
                    samples.append((b - a) * ((i + 0.5) / n1) + (c - a) * ((j + 0.5) / n2) + a)
    return samples


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 2))
def test_sampling_and_thinning_equal_plain_loops(seed: int, spacing: float) -> None:
    random = np.random.default_rng(seed)
    vertices, faces = random.normal(size=(9, 3)), random.integers(0, 9, (12, 3))
    samples, proper = sample_surface(vertices, faces, spacing)
    assert np.array_equal(samples, np.reshape(sample_by_loops(vertices, faces, spacing), (-1, 3)))
    assert proper == sum(len({*face}) == 3 for face in faces.tolist())
    cloud = np.concatenate([vertices, samples])[:800]
    alive = np.ones(len(cloud), bool)
    near = cdist(cloud, cloud) <= spacing
    for index in range(len(cloud)):
        if alive[index]:
            alive &= ~near[index]
            alive[index] = True
    assert np.array_equal(thin(cloud, spacing), cloud[alive])


def test_chamfer_without_points_is_none_with_a_reason() -> None:
    data = metrics.read_dtu_scan(DTU, 1)
    low, high = data.box.astype(float)
    middle = (low + high) / 2
    for points, reason in (
        (np.zeros((0, 3)), "bounds"),
        ([low - 61], "bounds"),
        ([low - 59], "observed volume"),
    ):
        result = metrics.chamfer_points(points, data)
        assert result["overall"] is None
        assert reason in result["reason"]
    seen = data.box[0] + np.argwhere(data.observed)[:1] * data.resolution
    assert "1e-06 mm" in metrics.chamfer_points(seen, data, max_distance=1e-6)["reason"]
    assert metrics.chamfer_points([middle], data)["n_inbound"] == 1


@settings(max_examples=25, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 40))
def test_chamfer_equals_distances_of_all_pairs(seed: int, limit: float) -> None:
    """On random clouds, voxels and planes, a loop applies the rules of the evaluation to each point."""
    random = np.random.default_rng(seed)
    box = np.array([[-4, 2, 100], [16, 12, 130]], np.float32)
    resolution = float(random.uniform(0.5, 4))
    shape = np.ceil((box[1] - box[0]) / resolution).astype(int) + 1
    data = metrics.DtuScan(
        points=random.uniform(box[0] - 30, box[1] + 30, (int(random.integers(1, 90)), 3)),
        observed=random.random(shape) < random.choice([0.1, 0.9]),
        box=box,
        resolution=resolution,
        plane=np.append(random.normal(size=3), random.normal(scale=50)),
    )
    cloud = random.uniform(box[0] - 90, box[1] + 150, (int(random.integers(1, 120)), 3))
    cloud[::2] = random.uniform(box[0], box[1], cloud[::2].shape)
    inside = [p for p in cloud if all(p >= box[0] - 60) and all(p < box[1] + 120)]
    seen = []
    for point in inside:
        voxel = [round(float(x)) for x in (point - box[0]) / resolution]
        if all(0 <= v < n for v, n in zip(voxel, shape, strict=True)) and data.observed[tuple(voxel)]:
            seen.append(point)
    above = [p for p in data.points if sum(p * data.plane[:3]) + data.plane[3] > 0]
    result = metrics.chamfer_points(cloud, data, max_distance=limit)
    assert (result["n_inbound"], result["n_in_obs"], result["n_stl_above"]) == tuple(
        map(len, (inside, seen, above))
    )
    for key, queries, targets in (("mean_d2s", seen, data.points), ("mean_s2d", above, inside)):
        nearest = [] if not queries or not len(targets) else cdist(queries, targets).min(axis=1)
        kept = [distance for distance in nearest if distance < limit]
        assert result[key] == (pytest.approx(np.mean(kept), rel=1e-12) if kept else None)


def test_mesh_in_wrong_units_is_rejected_before_sampling() -> None:
    mesh = read_mesh(DTU / "mesh1.ply")
    vertices, faces = mesh.vertices.astype(np.float64), mesh.faces
    data = metrics.read_dtu_scan(DTU, 1)
    with pytest.raises(MetricError, match=r"METRIC_MESH: .*millimetres"):
        metrics.chamfer_surface(vertices * 1000, faces, data)
    with pytest.raises(MetricError, match="METRIC_MESH"):
        metrics.chamfer_surface(vertices * 1e300, faces, data)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]]),
        (np.full((3, 3), np.nan), [[0, 1, 2]]),
        (np.zeros((3, 3)), [[0, 1, 3]]),
        (np.zeros((3, 3)), [[0, 1, -1]]),
        (np.zeros((3, 3)), [0, 1, 2]),
    ],
)
def test_invalid_meshes_are_rejected(vertices: Any, faces: Any) -> None:
    with pytest.raises(MetricError, match="METRIC_MESH: "):
        metrics.chamfer_surface(vertices, faces, metrics.read_dtu_scan(DTU, 1))


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    shutil.copytree(DTU, tmp_path / "dtu")
    return tmp_path / "dtu"


FILES = ("Points/stl/stl001_total.ply", "ObsMask/ObsMask1_10.mat", "ObsMask/Plane1.mat", "mesh1.ply")


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("damage", ["gone", "noise"])
def test_missing_or_damaged_file_is_named(dataset: Path, name: str, damage: str) -> None:
    path = dataset / name
    path.unlink()
    if damage == "noise":
        path.write_bytes(b"noise" * 99)
    with pytest.raises((InputError, MeshFileError, MetricError)) as caught:
        metrics.chamfer_dtu(dataset / "mesh1.ply", dataset, 1)
    assert caught.value.file == str(path)
    assert caught.value.exit_status == 3
    with pytest.raises(InputError, match=r"FILE_NOT_FOUND: .*none: "):
        metrics.chamfer_dtu(DTU / "mesh1.ply", dataset / "none", 1)


GRID: dict[str, Any] = {
    "ObsMask": np.ones((3, 3, 3), np.uint8),
    "BB": np.array([[0, 0, 0], [1, 1, 1.0]]),
    "Res": np.array([[0.5]]),
}
EXTENTS = struct.pack("<3i", 3, 3, 3)
# Changed variables (None: omitted), and bytes to replace.
BAD_GRIDS: dict[str, tuple[dict[str, Any], bytes, bytes]] = {
    "HDF5": ({}, b"\x00\x01IM", b"\x00\x02IM"),
    "negative axis": ({}, EXTENTS, struct.pack("<3i", -1, 3, 3)),
    "more voxels than bytes": ({}, EXTENTS, struct.pack("<3i", 300, 300, 300)),
    "text": ({"Res": "x"}, b"", b""),
    "complex": ({"BB": GRID["BB"] * 1j}, b"", b""),
    "NaN": ({"Res": np.array([[np.nan]])}, b"", b""),
    "beyond float32": ({"BB": GRID["BB"] * 1e39}, b"", b""),
    "no size": ({"Res": np.zeros((1, 1))}, b"", b""),
    "plane": ({"ObsMask": np.zeros((4, 4))}, b"", b""),
    "no mask": ({"ObsMask": None}, b"", b""),
}


@pytest.mark.parametrize("name", BAD_GRIDS)
def test_invalid_grid_files_are_rejected(name: str, dataset: Path) -> None:
    changes, old, new = BAD_GRIDS[name]
    stream = io.BytesIO()
    savemat(stream, {key: value for key, value in (GRID | changes).items() if value is not None})
    (dataset / "ObsMask" / "ObsMask1_10.mat").write_bytes(stream.getvalue().replace(old, new, 1))
    with pytest.raises(MetricError, match=r"METRIC_DTU: .*ObsMask1_10\.mat"):
        metrics.read_dtu_scan(dataset, 1)


RNG = np.random.default_rng(0)
NUMBERS: dict[str, Any] = {
    "ObsMask": RNG.integers(0, 2, (5, 4, 3)).astype(np.uint8),
    "BB": RNG.normal(size=(2, 3)),
    "whole": np.arange(6.0).reshape(2, 3),
    "single": RNG.normal(size=(2, 2)).astype(np.float32),
    "wide": np.arange(-3, 3).reshape(1, 2, 3),
    "flags": np.array([[True, False]]),
    "empty": np.zeros((0, 3)),
    "a_name_of_more_than_four_letters": np.uint8([[7]]),
}


def saved(*, packed: bool = False, **variables: Any) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables, do_compression=packed)
    return stream.getvalue()


@pytest.mark.parametrize("packed", [False, True])
def test_matlab_arrays_equal_those_read_by_scipy(packed: bool) -> None:
    content = saved(packed=packed, **NUMBERS)
    wanted, arrays = loadmat(io.BytesIO(content)), find_variables(content)
    assert list(arrays) == list(NUMBERS)
    for name, variable in arrays.items():
        values = variable.read()
        assert variable.shape == values.shape == wanted[name].shape
        np.testing.assert_array_equal(values, wanted[name])
        assert not values.flags.writeable


def test_non_numeric_variables_are_rejected() -> None:
    content = saved(text="a", cell=np.array([["x"]], object), table={"a": 1}, complex=np.array([[1j]]))
    for variable in find_variables(content).values():
        with pytest.raises(ValueError, match=variable.name):
            variable.read()


def test_decompression_stops_at_the_declared_size() -> None:
    """Reading a variable does not need more memory if a gigabyte of other data follows."""
    content = bytearray(saved(packed=True, Res=np.array([[0.5]])))
    body = zlib.decompress(bytes(content[136:]))
    longer = zlib.compress(body + bytes(1 << 24), 9)
    content[132:] = len(longer).to_bytes(4, "little") + longer
    assert find_variables(bytes(content))["Res"].read().tolist() == [[0.5]]
