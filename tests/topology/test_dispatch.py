"""The choice between NumPy and kernels. Users notice it only by the time."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb import audit
from msb.topology import audit_arrays, dispatch
from tests.topology import brute_force
from tests.topology.meshes import random_mesh

MESH = splat_like(12)


@pytest.fixture
def kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the kernels for every mesh with faces."""
    monkeypatch.setattr(dispatch, "FEWEST_FACES", 1)


def report(**options: object) -> dict[str, object]:
    data = audit(*MESH, **options).to_dict()
    return {key: value for key, value in data.items() if key not in ("timings_ms", "computed_by")}


@pytest.mark.parametrize("weld", [None, "exact", 0.02])
def test_report_is_equal_for_numpy_and_kernels(monkeypatch: pytest.MonkeyPatch, weld: object) -> None:
    by_numpy = report(weld=weld)
    monkeypatch.setattr(dispatch, "FEWEST_FACES", 1)
    assert audit(*MESH).computed_by.startswith("OpenCL, ")
    assert report(weld=weld) == by_numpy


def test_small_mesh_never_uses_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatch, "_shared_cpu", None)
    assert audit(*MESH).computed_by == "NumPy"


@pytest.mark.usefixtures("kernels")
def test_kernels_agree_with_the_brute_force_twin() -> None:
    random = np.random.default_rng(77)
    for _ in range(150):
        points, faces = random_mesh(random)
        result = audit(points, faces)
        assert result.computed_by.startswith("OpenCL" if len(faces) else "NumPy")
        brute_force.assert_agrees(result, points, faces)


@pytest.mark.usefixtures("kernels")
def test_analysis_is_computed_on_first_use() -> None:
    result, analysis = audit_arrays(*MESH)
    assert analysis.timings_ms == {}
    assert len(analysis.offending.vertices["nonmanifold_vertices"]) == result.counts.nonmanifold_vertices
    assert "fans" in analysis.timings_ms


@pytest.mark.usefixtures("kernels")
@pytest.mark.parametrize("selector", ["nosuch", "::"])
def test_numpy_replaces_a_missing_device_with_a_reason(
    monkeypatch: pytest.MonkeyPatch, selector: str
) -> None:
    expected = report()
    monkeypatch.setenv("MSB_DEVICE", selector)
    assert report() == expected
    assert audit(*MESH).computed_by.startswith("NumPy (")


@pytest.mark.usefixtures("kernels")
def test_int64_faces_use_numpy() -> None:
    points, faces = MESH
    findings, _ = dispatch.find_findings(points, faces.astype(np.int64))
    assert findings.computed_by == "NumPy"


def test_gpu_is_never_used_for_an_audit(monkeypatch: pytest.MonkeyPatch) -> None:
    gpu = SimpleNamespace(record=SimpleNamespace(kind="gpu", style="gpu"), selector="gpu")
    monkeypatch.setattr("msb.cl.devices.choose_device", lambda: gpu)
    assert dispatch._shared_cpu().record.kind == "cpu"


def test_threads_can_audit_at_the_same_time() -> None:
    expected, results = audit(*MESH).counts, []
    threads = [threading.Thread(target=lambda: results.append(audit(*MESH).counts)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [expected] * 4
