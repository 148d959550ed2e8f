"""Functions that need no installed engine: meshes, cameras, agreement, messages about missing programs."""

import io
import queue
import sys
import tempfile
import threading
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from msb.base import extras
from msb.engines import blender, browser, webgpu
from msb.engines.agreement import agreement
from msb.engines.blender import CyclesRenderer, blender_camera
from msb.engines.engine import engine_mesh, opaque_frame
from msb.engines.threejs import ThreeJsRenderer
from msb.engines.webgpu import WgpuRenderer, pack_camera
from msb.engines.webgpu_texture import split_runs
from msb.errors import DeviceError, Unsupported, UsageError
from msb.meshes import read_mesh
from msb.render import Frame
from msb.render.backend import why_unavailable
from msb.render.frame import interior
from tests.engines.conftest import need
from tests.render.standard_scenes import camera, mesh_asset, random_colors, scene

SQUARE = (
    np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], np.float32),
    np.array([[0, 1, 2], [2, 1, 3]], np.uint32),
)


@pytest.mark.parametrize(("domain", "rows"), [("vertex", 4), ("face", 2), ("corner", 6)])
def test_face_and_corner_colours_duplicate_vertices(domain: str, rows: int) -> None:
    positions, faces = SQUARE
    colors = np.arange(4 * rows, dtype=np.uint8).reshape(rows, 4)
    mesh = engine_mesh(mesh_asset(SQUARE, colors, domain), {})
    np.testing.assert_array_equal(mesh.positions[mesh.indices], positions[faces])
    assert (mesh.numbers, len(mesh.positions)) == (None, 4 if domain == "vertex" else 6)
    row = {"vertex": faces.reshape(-1), "face": [0, 0, 0, 1, 1, 1], "corner": range(6)}[domain]
    np.testing.assert_array_equal(mesh.colors[mesh.indices.reshape(-1)], colors[list(row), :3])


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_engines_draw_the_file_that_convert_writes(tmp_path: Path, suffix: str) -> None:
    vertices, faces = scene("small", 1)
    asset = mesh_asset((vertices, faces), random_colors(1, len(vertices), np.float32))
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(engine_mesh(asset, {}).to_bytes(suffix))
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_colors, np.clip(asset.buffers["color"], 0, 1), atol=1e-7)


@pytest.mark.parametrize("distance", [0.0, 1e6])
def test_the_clip_matrix_projects_as_the_camera_does(distance: float) -> None:
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    pose[:3, 3] = -pose[:3, :3] @ (distance, 2.25, -1.5)
    view = replace(camera(100, 80, 90.0, (40.0, 50.0), pose))
    points = np.random.default_rng(2).normal((distance, 2.25, -1.5), size=(50, 3))
    record = pack_camera(view)
    local = (points - record[16:19]) - record[20:23]
    clip = np.append(local, np.ones((50, 1)), axis=1).astype(np.float32) @ record[:16].reshape(4, 4)
    pixels, depth = view.project(points)
    front = depth > 0.1
    np.testing.assert_allclose((clip[:, 0] / clip[:, 3] + 1)[front] * 50, pixels[front, 0], atol=2e-3)
    np.testing.assert_allclose((1 - clip[:, 1] / clip[:, 3])[front] * 40, pixels[front, 1], atol=2e-3)
    np.testing.assert_allclose(clip[:, 3], depth, atol=1e-5)
    np.testing.assert_allclose(clip[:, 2], 0.01, rtol=1e-6)


@pytest.mark.parametrize(("fx", "fy"), [(100.0, 100.0), (100.0, 80.0), (80.0, 100.0)])
def test_blender_has_the_same_intrinsics(fx: float, fy: float) -> None:
    view = replace(camera(120, 90, fx, (50.0, 52.0)), fx=fx, fy=fy)
    settings = blender_camera(view, np.eye(4))
    aspect_x, aspect_y = settings["aspect"]
    assert min(aspect_x, aspect_y) == 1
    # In Blender the focal length in pixels is lens * width / sensor width. The height of a pixel is its width
    # times aspect_y / aspect_x.
    focal = settings["lens"] * 120 / settings["sensor_width"]
    assert focal == pytest.approx(fx)
    assert focal * aspect_x / aspect_y == pytest.approx(fy)
    shift_x, shift_y = settings["shift"]
    assert 60 - shift_x * 120 == pytest.approx(50)
    assert 45 + shift_y * 120 * aspect_x / aspect_y == pytest.approx(52)
    np.testing.assert_allclose(np.array(settings["matrix"]), np.diag([1, -1, -1, 1]))


@pytest.mark.parametrize(
    "view", [camera(3, 90), replace(camera(), fx=1000.0, fy=1.0), replace(camera(), fx=1.0, fy=1000.0)]
)
def test_cameras_beyond_blenders_limits_are_rejected(view: Any) -> None:
    with pytest.raises(Unsupported) as info:
        blender_camera(view, np.eye(4))
    assert info.value.code == "UNSUPPORTED_CAMERA"


def make_frame(image: np.ndarray, faces: np.ndarray) -> Frame:
    hit = faces >= 0
    return opaque_frame(image, hit, hit.astype(np.float32), (0, 0, 0), faces.astype(np.int32), {})


def test_agreement_counts_pixels() -> None:
    faces = np.zeros((10, 10), np.int32)
    faces[:, 5:] = 1
    faces[0] = -1
    image = np.full((10, 10, 3), 0.4, np.float32)
    ours = make_frame(image, faces)
    same = agreement([ours], [ours])
    assert (same.within_a_level, same.psnr, same.covered_alike, same.interior_max) == (1, np.inf, 1, 0)
    # Pixels whose 3 x 3 neighbourhood lies within one face: rows 2 to 8, columns 1 to 3 and 6 to 8.
    assert same.interior == 7 * 6
    assert interior(faces).sum() == 42
    changed = image.copy()
    changed[5, 2] += 10 / 255  # in the interior
    changed[5, 4] += 10 / 255  # at the edge
    changed[5, 7, 1] += 0.9 / 255
    fewer = faces.copy()
    fewer[1, :2] = -1
    different = agreement([make_frame(changed, fewer)], [ours])
    assert different.within_a_level == pytest.approx(0.96)
    assert different.covered_alike == pytest.approx(0.98)
    assert different.interior_within_a_level == pytest.approx(41 / 42)
    assert different.interior_max == 10
    assert 20 < different.psnr < 40


def test_missing_programs_and_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    monkeypatch.delenv(blender.VARIABLE, raising=False)
    monkeypatch.setenv(browser.VARIABLE, "no-such-browser")
    for renderer in (WgpuRenderer, CyclesRenderer, ThreeJsRenderer):
        with pytest.raises(UsageError) as info:
            renderer(mesh_asset(scene("small", 1)))
        assert info.value.code == "ENGINE_MISSING"
        assert why_unavailable(renderer.name) in info.value.message
    monkeypatch.setenv(blender.VARIABLE, sys.executable)
    assert "OpenEXR" in str(CyclesRenderer.missing())
    monkeypatch.setattr(extras, "find_spec", lambda _: True)
    monkeypatch.setattr(webgpu, "list_adapters", list)
    assert "driver" in str(WgpuRenderer.missing())
    monkeypatch.setenv(blender.VARIABLE, "no-such-python")
    assert "MSB_BLENDER" in str(CyclesRenderer.missing())


@pytest.mark.slow
def test_the_server_rejects_guessed_addresses_and_a_dead_browser_is_an_error() -> None:
    need("threejs")
    with ThreeJsRenderer(mesh_asset(scene("small", 1))) as renderer:
        page = renderer._page
        port = page._server.server_address[1]
        used = page._process.args[-1].partition(f":{port}/")[2]
        for path in ("", "page.html", "mesh.glb", "next", used, f"{used}page.html", f"{used}../page.html"):
            with pytest.raises(HTTPError) as reply:
                urlopen(f"http://127.0.0.1:{port}/{path}", timeout=10)
            assert reply.value.code == 404
            reply.value.close()
        page._process.kill()
        page._process.wait(timeout=60)
        with pytest.raises(DeviceError) as info:
            renderer.render(camera(), (0, 0, 0))
        assert info.value.code == "ENGINE_FAILED"


def test_a_renderer_that_fails_to_open_releases_its_device(monkeypatch: pytest.MonkeyPatch) -> None:
    need("wgpu")
    closed = []
    monkeypatch.setattr(WgpuRenderer, "_make_mesh", lambda _: 1 / 0)
    close = webgpu.Gpu.close
    monkeypatch.setattr(webgpu.Gpu, "close", lambda gpu: (closed.append(gpu), close(gpu)))
    with pytest.raises(ZeroDivisionError):
        WgpuRenderer(mesh_asset(scene("small", 1)))
    assert [gpu.device for gpu in closed] == [None]


class Tasks(queue.Queue[bytes]):
    """A queue of tasks that reports which thread waits for the next task."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: queue.Queue[threading.Thread] = queue.Queue()

    def get(self, *args: Any, **options: Any) -> bytes:
        self.waiting.put(threading.current_thread())
        return super().get(*args, **options)


def test_the_public_address_works_once_and_closing_ends_all_threads() -> None:
    tasks = Tasks()
    handler = browser._handler("/s/", {"/once/": "/s/page.html?x"}, {"page.html": b"hi"}, tasks, tasks)
    server = browser._Server(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()

    def request(path: str) -> tuple[int, str | None, bytes]:
        connection = HTTPConnection(*server.server_address[:2], timeout=30)
        connection.request("GET", path)
        reply = connection.getresponse()
        answer = reply.status, reply.getheader("Location"), reply.read()
        connection.close()
        return answer

    assert request("/once/") == (302, "/s/page.html?x", b"")
    assert [request(path)[0] for path in ("/once/", "/s/", "/s/../page.html", "/")] == [404] * 4
    assert request("/s/page.html?x")[2] == b"hi"

    waiting = HTTPConnection(*server.server_address[:2], timeout=30)
    waiting.request("GET", "/s/next")
    thread = tasks.waiting.get(timeout=30)
    waiting.close()  # a browser that is ended also drops its connection
    assert thread.is_alive()
    browser._end(None, server, tasks, io.BytesIO(), tempfile.TemporaryDirectory())
    thread.join(30)
    assert not thread.is_alive()


def test_the_depth_range_bounds_all_vertices() -> None:
    mesh = scene("through the camera", 1)
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    low, high = engine_mesh(mesh_asset(mesh), {}).depth_range(matrix)
    depths = mesh[0] @ matrix[2, :3]
    assert low <= depths.min() < depths.max() <= high


def test_a_python_without_bpy_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "import sys; sys.exit(\'no bpy here\')"\n')
    python.chmod(0o755)
    monkeypatch.setenv(blender.VARIABLE, str(python))
    with pytest.raises(DeviceError) as info:
        CyclesRenderer(mesh_asset(scene("small", 1)))
    assert info.value.code == "ENGINE_FAILED"


def test_faces_are_drawn_in_runs_of_one_texture() -> None:
    assert split_runs(np.array([4, 4, 2, 4], np.uint32)) == [(4, 0, 2), (2, 2, 1), (4, 3, 1)]
