"""The OpenCL kernels equal NumPy bit for bit, for every mesh, all sizes and any number of threads."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_stubs.splat_like import splat_like
from data_stubs.surface import icosphere
from msb import audit
from msb.cl import Device, open_device
from msb.topology.analysis import Analysis
from msb.topology.arrays import mesh_arrays
from msb.topology.findings import Findings, find_by_numpy
from msb.topology.kernel import Sizes, find_by_kernels
from tests.conftest import BOOK
from tests.topology import brute_force
from tests.topology.meshes import CASES
from tests.topology.test_properties import QUICK, Mesh, meshes, seeds

DEFAULT = Sizes()
# With these sizes, a dozen faces test large vertices, large blocks, several rounds and many chunks of pairs.
TINY = Sizes(
    block_corners=6,
    most_blocks=64,
    large_block=4,
    rounds=3,
    most_compared=8,
    chunk_pairs=64,
    valences=4,
)


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    """Return an open CPU device."""
    with open_device("cpu") as opened:
        yield opened


def check(device: Device, mesh: Mesh, sizes: Sizes = DEFAULT, workers: int | None = None) -> Findings:
    """Return the findings of the kernels, and assert that NumPy gives the same."""
    points, faces = mesh_arrays(*mesh)
    kernels = find_by_kernels(points, faces, device, sizes=sizes, workers=workers)
    assert kernels == find_by_numpy(Analysis(points, faces))
    assert kernels.largest_component_area <= kernels.total_area
    if kernels.counts.components == 1:
        assert kernels.largest_component_area == kernels.total_area
    return kernels


def everywhere(device: Device, mesh: Mesh) -> Findings:
    """Check default and tiny sizes with one, two and more work-items. Return the findings."""
    check(device, mesh, workers=1)
    check(device, mesh, TINY, workers=1)
    check(device, mesh, TINY, workers=5)
    return check(device, mesh, TINY, workers=2)


# --- any mesh


@pytest.mark.parametrize("case", [c for c in CASES if c.valid and len(c.faces)], ids=lambda c: c.name)
def test_kernels_equal_numpy_on_hand_made_cases(device: Device, case: object) -> None:
    everywhere(device, (case.vertices, case.faces))


@QUICK
@given(mesh=meshes())
def test_kernels_equal_numpy_on_small_meshes(device: Device, mesh: Mesh) -> None:
    if len(mesh[1]):
        everywhere(device, mesh)


@st.composite
def crowded(draw: st.DrawFn) -> Mesh:
    """Draw hundreds of faces on few vertices, or fans and books of faces, with full-precision positions."""
    random = draw(seeds)
    count = draw(st.integers(3, 80))
    faces = random.integers(0, count, (draw(st.integers(1, 300)), 3))
    match draw(st.sampled_from(["any", "star", "book", "fan", "strip", "twice"])):
        case "star":
            faces[:, 0] = count - 1
        case "book":
            faces[:, :2] = 0, count // 2
        case "fan":
            turn = random.permutation(count)
            faces = np.stack([np.full(count, turn[0]), turn, np.roll(turn, 1)], axis=1)
        case "strip":
            faces = np.lib.stride_tricks.sliding_window_view(random.permutation(count), 3)
        case "twice":
            faces = np.concatenate([faces, random.permuted(faces, axis=1)])
    return random.standard_normal((count + 2, 3)) * 10.0 ** random.integers(-3, 4), faces


@QUICK
@given(mesh=crowded())
def test_kernels_equal_numpy_on_crowded_meshes(device: Device, mesh: Mesh) -> None:
    everywhere(device, mesh)


@pytest.mark.parametrize("shuffle", [False, True])
def test_kernels_equal_numpy_on_splat_like_meshes(device: Device, shuffle: bool) -> None:
    mesh = splat_like(14, shuffle=shuffle)
    for sizes in (DEFAULT, replace(DEFAULT, block_corners=512), TINY):
        for workers in (1, 2, 7):
            check(device, mesh, sizes, workers)


# --- arrays


def test_read_only_and_unaligned_arrays(device: Device) -> None:
    vertices, faces = splat_like(8)
    raw = bytearray(faces.nbytes + 1)
    odd = np.frombuffer(raw, np.int32, faces.size, offset=1).reshape(-1, 3)
    odd[:] = faces
    frozen = faces.copy()
    frozen.flags.writeable = False
    wide = np.zeros((len(vertices), 5), np.float32)
    wide[:, 1:4] = vertices
    for points_, faces_ in ((vertices, odd), (vertices, frozen), (wide[:, 1:4], faces)):
        check(device, (points_, faces_))
    np.testing.assert_array_equal(odd, faces)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200, 1e-200])
def test_nonfinite_and_tiny_areas(device: Device, value: float) -> None:
    vertices = np.array(BOOK[0], np.float64)
    vertices[2] = value
    check(device, (vertices, BOOK[1]))
    brute_force.assert_agrees(audit(vertices, BOOK[1]), vertices, BOOK[1])


def test_ties_of_the_largest_component_go_to_area_then_order(device: Device) -> None:
    faces = np.arange(12).reshape(-1, 3)
    flat = np.zeros((12, 3))
    assert check(device, (flat, faces)).largest_component_area == 0
    flat[[4, 8], 0] = flat[[5, 9], 1] = 2.0
    flat[[7, 1], 0] = flat[[8, 2], 1] = 1.0
    assert everywhere(device, (flat, faces)).largest_component_area == 2


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [1, 8, 24])
def test_connected_mesh_has_all_its_area_in_the_largest_component(device: Device, frequency: int) -> None:
    random = np.random.default_rng(frequency)
    directions, faces = icosphere(frequency)
    vertices = directions * random.uniform(0.9, 1.1, (len(directions), 1)) / 3
    # `check` compares the two areas.
    assert check(device, (vertices, random.permutation(faces))).counts.components == 1


# --- the device


def test_audit_releases_all_device_memory(device: Device) -> None:
    before = device.memory()
    result = check(device, splat_like(8))
    assert device.memory() == before
    assert result.computed_by.startswith("OpenCL, ")
    assert sum(result.timings_ms.values()) > 0
