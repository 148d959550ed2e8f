"""What the engines are made of, without any of them: the mesh, cameras, agreement, what is missing."""

import io
import queue
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.base import extras
from msb.engines import blender, browser, webgpu
from msb.engines.agreement import agreement
from msb.engines.blender import CyclesRenderer, blender_camera
from msb.engines.engine import engine_mesh, opaque_frame
from msb.engines.threejs import ThreeJsRenderer
from msb.engines.webgpu import WgpuRenderer, camera_record
from msb.engines.webgpu_texture import runs_of
from msb.errors import DeviceError, Unsupported, UsageError
from msb.meshes import read_mesh
from msb.render import Frame
from msb.render.backend import what_is_missing
from msb.render.frame import interior
from tests.engines.conftest import need
from tests.render.standard_scenes import camera, mesh_asset, random_colors, scene

EYE = np.eye(4)
SQUARE = (
    np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], np.float32),
    np.array([[0, 1, 2], [2, 1, 3]], np.uint32),
)


@pytest.mark.parametrize(("domain", "rows"), [("vertex", 4), ("face", 2), ("corner", 6)])
def test_colours_of_faces_and_corners_need_vertices_of_their_own(domain: str, rows: int) -> None:
    positions, faces = SQUARE
    colors = np.arange(4 * rows, dtype=np.uint8).reshape(rows, 4)
    found = engine_mesh(mesh_asset(SQUARE, colors, domain), {})
    np.testing.assert_array_equal(found.positions[found.indices], positions[faces])
    assert (found.numbers, len(found.positions)) == (None, 4 if domain == "vertex" else 6)
    of_corners = {"vertex": faces.reshape(-1), "face": [0, 0, 0, 1, 1, 1], "corner": range(6)}[domain]
    np.testing.assert_array_equal(found.colors[found.indices.reshape(-1)], colors[list(of_corners), :3])


def test_what_is_given_to_an_engine_is_what_convert_writes(tmp_path: Path) -> None:
    mesh = scene("small", 1)
    asset = mesh_asset(mesh, random_colors(1, len(mesh[0]), np.float32))
    for suffix in (".ply", ".glb"):
        path = tmp_path / f"mesh{suffix}"
        path.write_bytes(engine_mesh(asset, {}).encoded(suffix))
        back = read_mesh(path)
        np.testing.assert_array_equal(back.vertices, mesh[0])
        np.testing.assert_array_equal(back.faces, mesh[1])
        np.testing.assert_allclose(back.vertex_colors, np.clip(asset.buffers["color"], 0, 1), atol=1e-7)


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_the_clip_matrix_projects_as_the_camera_does(far: float) -> None:
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    pose[:3, 3] = -pose[:3, :3] @ (far, 2.25, -1.5)
    view = replace(camera(100, 80, 90.0, (40.0, 50.0), pose))
    points = np.random.default_rng(2).normal((far, 2.25, -1.5), size=(50, 3))
    record = camera_record(view)
    local = (points - record[16:19]) - record[20:23]
    clip = np.append(local, np.ones((50, 1)), axis=1).astype(np.float32) @ record[:16].reshape(4, 4)
    pixels, depth = view.project(points)
    seen = depth > 0.1
    np.testing.assert_allclose((clip[:, 0] / clip[:, 3] + 1)[seen] * 50, pixels[seen, 0], atol=2e-3)
    np.testing.assert_allclose((1 - clip[:, 1] / clip[:, 3])[seen] * 40, pixels[seen, 1], atol=2e-3)
    np.testing.assert_allclose(clip[:, 3], depth, atol=1e-5)
    np.testing.assert_allclose(clip[:, 2], 0.01, rtol=1e-6)


@pytest.mark.parametrize(("fx", "fy"), [(100.0, 100.0), (100.0, 80.0), (80.0, 100.0)])
def test_blender_has_the_same_intrinsics(fx: float, fy: float) -> None:
    view = replace(camera(120, 90, fx, (50.0, 52.0)), fx=fx, fy=fy)
    found = blender_camera(view, EYE)
    across, along = found["aspect"]
    assert min(across, along) == 1
    # Blender: f in pixels = lens * W / sensor width, a pixel is aspect_y / aspect_x as high as it is wide.
    focal = found["lens"] * 120 / found["sensor_width"]
    assert focal == pytest.approx(fx)
    assert focal * across / along == pytest.approx(fy)
    shift_x, shift_y = found["shift"]
    assert 60 - shift_x * 120 == pytest.approx(50)
    assert 45 + shift_y * 120 * across / along == pytest.approx(52)
    np.testing.assert_allclose(np.array(found["matrix"]), np.diag([1, -1, -1, 1]))


def test_cameras_blender_lacks_are_refused() -> None:
    for view in (camera(3, 90), replace(camera(), fx=1000.0, fy=1.0), replace(camera(), fx=1.0, fy=1000.0)):
        with pytest.raises(Unsupported, match="UNSUPPORTED_CAMERA"):
            blender_camera(view, EYE)


def frame(image: np.ndarray, faces: np.ndarray) -> Frame:
    hit = faces >= 0
    return opaque_frame(image, hit, hit.astype(np.float32), (0, 0, 0), faces.astype(np.int32), {})


def test_agreement_counts() -> None:
    faces = np.zeros((10, 10), np.int32)
    faces[:, 5:] = 1
    faces[0] = -1
    image = np.full((10, 10, 3), 0.4, np.float32)
    ours = frame(image, faces)
    same = agreement([ours], [ours])
    assert (same.within_a_level, same.psnr, same.covered_alike, same.interior_max) == (1, np.inf, 1, 0)
    # 3 x 3 neighbourhoods within one face: rows 2..8, columns 1..3 and 6..8.
    assert same.interior == 7 * 6
    assert interior(faces).sum() == 42
    other = image.copy()
    other[5, 2] += 10 / 255  # inside
    other[5, 4] += 10 / 255  # at the edge
    other[5, 7, 1] += 0.9 / 255
    fewer = faces.copy()
    fewer[1, :2] = -1
    found = agreement([frame(other, fewer)], [ours])
    assert found.within_a_level == pytest.approx(0.96)
    assert found.covered_alike == pytest.approx(0.98)
    assert found.interior_within_a_level == pytest.approx(41 / 42)
    assert found.interior_max == 10
    assert 20 < found.psnr < 40


def test_what_is_missing_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    asset = mesh_asset(scene("small", 1))
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    monkeypatch.delenv(blender.VARIABLE, raising=False)
    monkeypatch.setenv(browser.VARIABLE, "no-such-browser")
    for factory in (WgpuRenderer, CyclesRenderer, ThreeJsRenderer):
        with pytest.raises(UsageError, match="ENGINE_MISSING") as info:
            factory(asset)
        assert what_is_missing(factory.name) in info.value.message
    monkeypatch.setenv(blender.VARIABLE, sys.executable)
    assert "OpenEXR is not installed" in str(CyclesRenderer.missing())
    monkeypatch.setattr(extras, "find_spec", lambda _: True)
    monkeypatch.setattr(webgpu, "all_adapters", list)
    assert "driver" in str(WgpuRenderer.missing())
    monkeypatch.setenv(blender.VARIABLE, "no-such-python")
    assert "MSB_BLENDER" in str(CyclesRenderer.missing())


@pytest.mark.slow
def test_a_browser_that_ends_is_told() -> None:
    need("threejs")
    asset = mesh_asset(scene("small", 1))
    with ThreeJsRenderer(asset) as renderer:
        renderer._page._process.kill()
        renderer._page._process.wait(timeout=60)
        with pytest.raises(DeviceError, match="ENGINE_FAILED") as info:
            renderer.render(camera(), (0, 0, 0))
        assert info.value.code == "ENGINE_FAILED"


@pytest.mark.slow
def test_only_the_page_is_served() -> None:
    from urllib.error import HTTPError
    from urllib.request import urlopen

    need("threejs")
    with ThreeJsRenderer(mesh_asset(scene("small", 1))) as renderer:
        page = renderer._page
        port = page._server.server_address[1]
        shown = page._process.args[-1].partition(f":{port}/")[2]
        for path in ("", "page.html", "mesh.glb", "next", shown, f"{shown}page.html", f"{shown}../page.html"):
            with pytest.raises(HTTPError) as info:
                urlopen(f"http://127.0.0.1:{port}/{path}", timeout=10)
            assert info.value.code == 404
            info.value.close()


def test_a_renderer_that_fails_when_it_opens_leaves_nothing_on_the_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    need("wgpu")
    closed = []
    monkeypatch.setattr(WgpuRenderer, "_make_mesh", lambda _: 1 / 0)
    close = webgpu.Gpu.close
    monkeypatch.setattr(webgpu.Gpu, "close", lambda gpu: (closed.append(gpu), close(gpu)))
    with pytest.raises(ZeroDivisionError):
        WgpuRenderer(mesh_asset(scene("small", 1)))
    assert [gpu.device for gpu in closed] == [None]


class Tasks(queue.Queue[bytes]):
    """Tasks that tell which thread waits for one."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: queue.Queue[threading.Thread] = queue.Queue()

    def get(self, *args: Any, **options: Any) -> bytes:
        self.waiting.put(threading.current_thread())
        return super().get(*args, **options)


def test_an_address_that_all_users_see_leads_to_the_page_once_and_a_closed_page_holds_nothing() -> None:
    from http.client import HTTPConnection

    tasks = Tasks()
    handler = browser._handler("/s/", {"/once/": "/s/page.html?x"}, {"page.html": b"hi"}, tasks, tasks)
    server = browser._Server(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()

    def ask(path: str) -> tuple[int, str | None, bytes]:
        connection = HTTPConnection(*server.server_address[:2], timeout=30)
        connection.request("GET", path)
        reply = connection.getresponse()
        found = reply.status, reply.getheader("Location"), reply.read()
        connection.close()
        return found

    assert ask("/once/") == (302, "/s/page.html?x", b"")
    assert [ask(path)[0] for path in ("/once/", "/s/", "/s/../page.html", "/")] == [404] * 4
    assert ask("/s/page.html?x")[2] == b"hi"

    waiting = HTTPConnection(*server.server_address[:2], timeout=30)
    waiting.request("GET", "/s/next")
    thread = tasks.waiting.get(timeout=30)
    waiting.close()  # as a browser that is ended does
    assert thread.is_alive()
    browser._end(None, server, tasks, io.BytesIO(), tempfile.TemporaryDirectory())
    thread.join(30)
    assert not thread.is_alive()


def test_depths_lie_in_the_range() -> None:
    mesh = scene("through the camera", 1)
    pose = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = pose
    low, high = engine_mesh(mesh_asset(mesh), {}).depth_range(matrix)
    depths = mesh[0] @ pose[2]
    assert low <= depths.min() < depths.max() <= high


def test_a_python_without_bpy_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "import sys; sys.exit(\'no bpy here\')"\n')
    python.chmod(0o755)
    monkeypatch.setenv(blender.VARIABLE, str(python))
    with pytest.raises(DeviceError, match="ENGINE_FAILED") as info:
        CyclesRenderer(mesh_asset(scene("small", 1)))
    assert info.value.code == "ENGINE_FAILED"


def test_faces_are_drawn_in_runs_of_one_texture() -> None:
    assert runs_of(np.array([4, 4, 2, 4], np.uint32)) == [(4, 0, 2), (2, 2, 1), (4, 3, 1)]
