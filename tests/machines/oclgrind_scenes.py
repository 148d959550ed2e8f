"""Kernels of the GPU style under Oclgrind: no data races, invalid accesses or divergent barriers.

Run these tests with `python -m tests.machines oclgrind`, which sets their environment.
"""

import os
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.cl import Device, exclusive_scan, sort_pairs
from msb.meshes.mesh import Mesh
from msb.reference import render_reference
from msb.render.dedicated import dedicated_renderer
from msb.render.splat.pipeline import SplattingPipeline
from msb.render.standard.renderer import StandardRenderer
from tests.cl.conftest import KERNELS, WITHOUT_ATOMICS, open_styled
from tests.reference.soups import SPLATTING, front_camera, random_triangles, soup
from tests.render.standard_scenes import scattered, unshared
from tests.render.textured_scenes import CASES, textured_asset

pytestmark = pytest.mark.skipif(
    "OCLGRIND_DATA_RACES" not in os.environ, reason="python -m tests.machines oclgrind runs this"
)
BACKGROUND = (0.0, 0.5, 1.0)


KNOWN = {
    # A kernel reads a pixel before the atomic operation that may change it. The value of a pixel only grows
    # (or only shrinks), so an outdated value can only cause a superfluous atomic operation.
    "Read-write data race at global memory address": r"(?s)Kernel: (triangles|listed_triangles|raster)\n"
    r"(?=.* = load volatile )(?=.*@_Z(8atom|10atomic)_(max|min))",
    # pyopencl queries properties of later OpenCL versions on devices of OpenCL 1.2.
    "Oclgrind - OpenCL runtime error": r"Function: clGetDeviceInfo\s+Error: +CL_INVALID_VALUE",
}
"""Harmless reports: start of the first line -> pattern that the complete report contains."""


def is_known(report: str) -> bool:
    return any(report.startswith(title) and re.search(text, report) for title, text in KNOWN.items())


class Watch:
    """New reports of Oclgrind: data races in its log, and errors of API calls on standard error."""

    def __init__(self, log: Path, capfd: pytest.CaptureFixture[str]) -> None:
        self._log, self._capfd = log, capfd
        self._seen = log.stat().st_size if log.exists() else 0

    def findings(self) -> list[str]:
        """Return the new reports that are not harmless: a line and the indented lines below it."""
        text = self._log.read_bytes()[self._seen :].decode() if self._log.exists() else ""
        self._seen += len(text.encode())
        text += "\n" + self._capfd.readouterr().err + "\n"
        reports = re.findall(r"^[^\s].*\n(?:(?:\t.*)?\n)*", text, re.MULTILINE)
        return [report for report in reports if not is_known(report)]


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log file of Oclgrind, which reads OCLGRIND_LOG whenever a context is created."""
    path = tmp_path_factory.mktemp("oclgrind") / "log"
    os.environ["OCLGRIND_LOG"] = str(path)
    return path


@pytest.fixture
def watch(log: Path, capfd: pytest.CaptureFixture[str]) -> Watch:
    return Watch(log, capfd)


@pytest.fixture(params=["gpu", WITHOUT_ATOMICS])
def device(request: pytest.FixtureRequest, log: Path) -> Iterator[Device]:
    with open_styled(request.param) as opened:
        yield opened


@pytest.fixture
def gpu(log: Path) -> Iterator[Device]:
    with open_styled("gpu") as opened:
        yield opened


def check_against_reference(renderer: Any, asset: Any, **options: Any) -> None:
    try:
        frame = renderer.render(front_camera(), BACKGROUND)
    finally:
        renderer.close()
    expected = render_reference(asset, front_camera(), BACKGROUND, **options)
    assert (frame.image != np.array(BACKGROUND, np.float32)).any(axis=-1).sum() > 100
    assert (np.abs(frame.image - expected.image).max(axis=-1) > 1e-3).mean() < 5e-3


@pytest.mark.parametrize(
    ("kernel", "title"),
    [
        ("races", "Write-write data race at global memory address"),
        ("reaches_beyond", "Invalid write of size 4 at global memory address"),
        ("diverges", "Work-group divergence detected (barrier)"),
    ],
)
def test_errors_of_kernels_are_detected(kernel: str, title: str, gpu: Device, watch: Watch) -> None:
    program = gpu.program("wrong", package=KERNELS)
    assert watch.findings() == []
    getattr(program, kernel)(4, 4, gpu.allocate(4, np.int32))
    gpu.finish()
    assert any(report.startswith(title) for report in watch.findings())


def test_scan_and_sort(gpu: Device, watch: Watch) -> None:
    values = np.random.default_rng(0).integers(0, 256, 2100, np.uint32)
    offsets = gpu.allocate(len(values) + 1, np.uint32)
    exclusive_scan(gpu, gpu.upload(values), offsets)
    assert np.array_equal(offsets.read()[1:], np.cumsum(values))
    keys, order = sort_pairs(gpu, gpu.upload(values), bits=8)
    assert np.array_equal(keys.read(), np.sort(values))
    assert np.array_equal(order.read(), np.argsort(values, kind="stable"))
    assert watch.findings() == []


@pytest.mark.parametrize("sampling", ["official", "engine"])
@pytest.mark.parametrize("method", SPLATTING)
def test_splatting(method: str, sampling: Any, gpu: Device, watch: Watch) -> None:
    asset = soup(method, random_triangles(1, 30), degree=1)
    renderer = dedicated_renderer(asset, device=gpu, sampling=sampling)
    check_against_reference(renderer, asset, sampling=sampling)
    assert watch.findings() == []


def test_splatting_in_drawing_order_with_several_batches_of_faces_per_tile(gpu: Device, watch: Watch) -> None:
    asset = soup("two_dts", random_triangles(1, 100, 2.0))
    with gpu:
        pipeline = SplattingPipeline(asset, device=gpu)
        pipeline._order_faces(at_frame=1)
        pipeline.render(front_camera(16, 12), BACKGROUND)
        assert pipeline.counts["pairs"] > 64
    assert watch.findings() == []


@pytest.mark.parametrize("method", SPLATTING)
def test_splatting_shares(method: str, gpu: Device, watch: Watch) -> None:
    asset, camera = soup(method, random_triangles(1, 100, 2.0)), front_camera(16, 12)
    settings = {"supersample": 2} if method == "mesh_splatting" else {}
    with gpu:
        pipeline = SplattingPipeline(asset, device=gpu, settings=settings)
        shares = pipeline.shares(camera, np.ones((12, 16, 3), np.float32))
    expected = render_reference(asset, camera, settings=settings).contribution / pipeline._model.scale**2
    np.testing.assert_allclose(shares, np.stack([expected] * 4, axis=1), rtol=1e-4, atol=1e-2)
    assert watch.findings() == []


@pytest.mark.parametrize("sampling", ["official", "engine"])
@pytest.mark.parametrize("method", SPLATTING)
def test_projection_reads_no_uninitialised_memory(
    method: str, sampling: Any, log: Path, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other stages cannot be checked: Oclgrind takes results of clEnqueueFillBuffer for uninitialised."""
    monkeypatch.setenv("OCLGRIND_UNINITIALIZED", "1")
    monkeypatch.delenv("OCLGRIND_DATA_RACES")
    settings = {"supersample": 1} if method == "mesh_splatting" else {}
    with open_styled("gpu") as device:
        asset = soup(method, random_triangles(1, 16))
        renderer = dedicated_renderer(asset, device=device, settings=settings, sampling=sampling)
        renderer.render(front_camera(8, 6), BACKGROUND)
        renderer.close()
    reports = [report for report in watch.findings() if "Controlflow depends on uninitialized" in report]
    assert [report for report in reports if "Kernel: project\n" in report] == []


def test_diffsoup(device: Device, watch: Watch) -> None:
    asset = soup("diffsoup", random_triangles(1, 30))
    check_against_reference(dedicated_renderer(asset, device=device), asset)
    assert watch.findings() == []


def test_standard(device: Device, watch: Watch) -> None:
    """Triangles of three sizes: for a work-item, for a work-group, and for several work-groups."""
    sizes = [random_triangles(*given) for given in ((1, 16, 0.3), (2, 5, 2.0), (3, 1, 40))]
    asset = soup("two_dts", np.concatenate(sizes))
    StandardRenderer(asset, device=device).render(front_camera(30, 20), BACKGROUND)
    assert watch.findings() == []


def test_textures(device: Device, watch: Watch) -> None:
    asset = textured_asset(
        unshared(scattered(4, 20, 0.8, 1, 4)), 5, **CASES["cut out"] | {"sizes": ((8, 8, 4), (4, 4, 4))}
    )
    StandardRenderer(asset, device=device).render(front_camera(12, 9), BACKGROUND)
    assert watch.findings() == []


def test_texture_by_least_squares(gpu: Device, watch: Watch) -> None:
    """Optimise the texels of a square from one training image."""
    renderers, systems = (
        pytest.importorskip(f"msb.bake.{name}") for name in ("texture_renderer", "texture_equations")
    )
    images = pytest.importorskip("msb.bake.images")
    place = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    corners = np.concatenate([place - 0.5, np.full((4, 1), 3, np.float32)], axis=1)
    faces, grey = np.array([[0, 1, 2], [0, 2, 3]]), np.full((8, 8, 3), 99, np.uint8)
    square = Mesh(corners, faces, corner_uvs=place[faces].reshape(-1, 2), textures=(grey,))
    target = np.full((9, 12, 3), 0.75, np.float32)
    with (
        images.ViewImages([front_camera(12, 9)], BACKGROUND, lambda _: target) as view,
        closing(systems.TextureEquations(8, gpu)) as equations,
        closing(renderers.TextureRenderer(square, view, gpu)) as renderer,
    ):
        equations.add_smoothness(np.zeros((8, 8), np.int32))
        assert [*renderer.add_equations(equations)] == [1]
        np.testing.assert_allclose(equations.solve(), 0.75 - 99 / 255, atol=0.01)
    assert watch.findings() == []
