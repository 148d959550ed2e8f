"""Renderers that `benchmarks.standard` compares with the standard tier.

A peer is a function of a scene. It prepares once and returns a function that draws a frame. This function
returns the image as bytes or floats, with row 0 at the top, or None if the peer has no colours. Images end in
host memory. Colours are the stored bytes, unlit and two-sided.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import c_library
from benchmarks.standard_scenes import FOCAL, HEIGHT, WIDTH, Scene, pose

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera

    Frame = Callable[[], NDArray[Any] | None]

NEAR, FAR = 0.01, 100.0
TEXELS = 2048
"""Side of the texture in texels."""


def _asset(scene: Scene) -> Asset:
    from msb.asset import Description, build_asset

    buffers = {"positions": scene.positions, "indices": scene.indices, "color": scene.colors}
    return build_asset(buffers, {"color": "vertex"}, Description(appearance={"kind": "static_color"}))


def _textured_asset(scene: Scene) -> Asset:
    """Return the scene with a noise texture that is mapped by direction.

    A million faces have about four texels each.
    """
    from msb.asset import Description, build_asset
    from msb.asset.texture import Sampler

    corners = scene.positions[scene.indices].astype(np.float64)
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    u = np.arctan2(corners[..., 2], corners[..., 0]) / (2 * np.pi)
    u -= np.rint(u - u[:, :1])  # keep each face on one side of the seam at u = 1
    uvs = np.stack([u, np.arccos(corners[..., 1]) / np.pi], axis=-1)
    random = np.random.default_rng(1)
    buffers = {
        "positions": scene.positions,
        "indices": scene.indices,
        "uv": uvs.reshape(-1, 2).astype(np.float32),
        "texture.0": random.integers(0, 256, (TEXELS, TEXELS, 3), dtype=np.uint8),
    }
    domains = {"uv": "corner", "texture.0": "global"}
    return build_asset(buffers, domains, Description(appearance=Sampler().appearance))


def _camera() -> Camera:
    from msb.scenes import Camera

    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose())


def msb(scene: Scene) -> Frame:
    """Prepare our renderer for images only."""
    from msb.render.standard.renderer import StandardRenderer

    renderer, camera = StandardRenderer(_asset(scene)), _camera()
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    return lambda: renderer.render_image(camera, out=image)


def msb_textured(scene: Scene) -> Frame:
    """Prepare our renderer for images only, with a texture instead of vertex colours.

    No peer is comparable.
    """
    from msb.render.standard.renderer import StandardRenderer

    renderer, camera = StandardRenderer(_textured_asset(scene)), _camera()
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)

    def frame() -> None:
        renderer.render_image(camera, out=image)

    return frame


def msb_frame(scene: Scene) -> Frame:
    """Prepare our renderer with image, coverage, depth and face ids."""
    from msb.render.standard.renderer import StandardRenderer

    renderer, camera = StandardRenderer(_asset(scene)), _camera()
    kept = renderer.render(camera, (0.0, 0.0, 0.0))
    return lambda: renderer.render(camera, (0.0, 0.0, 0.0), out=kept).image


def _plain_c(scene: Scene, bands: bool, ordered: bool) -> Frame:
    source = Path(__file__).with_name("standard_peer.c")
    draw = c_library(source, "-march=native", "-ffast-math").render
    positions, indices, colors = scene.positions, scene.indices, scene.colors
    if ordered:
        order = _spatial_order(positions[indices].mean(axis=1))
        indices = indices[order]
        if not scene.shared:
            positions, colors = positions[indices.reshape(-1)], colors[indices.reshape(-1)]
    view = pose()
    camera = np.concatenate([view[:3, :3].reshape(-1), view[:3, 3], [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2]])
    camera = camera.astype(np.float32)
    projected = np.zeros((len(positions) if scene.shared else 1, 4), np.float32)
    pixels = np.zeros(WIDTH * HEIGHT, np.uint64)
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    held = [np.ascontiguousarray(a) for a in (positions, indices, colors, camera)]
    vertices, faces, rgba, view_at = (ctypes.c_void_p(array.ctypes.data) for array in held)
    threads = int(os.environ.get("OMP_NUM_THREADS") or os.cpu_count() or 1)

    def frame() -> NDArray[Any]:
        counts = ctypes.c_long(len(held[0])), ctypes.c_long(len(held[1]))
        targets = (ctypes.c_void_p(array.ctypes.data) for array in (projected, pixels, image))
        shared = faces if scene.shared else None
        draw(vertices, shared, rgba, *counts, view_at, WIDTH, HEIGHT, int(bands), *targets, threads)
        return image

    return frame


def c_direct(scene: Scene) -> Frame:
    """Prepare plain C with 64-bit keys and atomics."""
    return _plain_c(scene, bands=False, ordered=False)


def c_bands(scene: Scene) -> Frame:
    """Prepare plain C that first sorts triangles into bands of rows."""
    return _plain_c(scene, bands=True, ordered=False)


def c_direct_ordered(scene: Scene) -> Frame:
    """Prepare `c_direct` on triangles in spatial order, as in our renderer."""
    return _plain_c(scene, bands=False, ordered=True)


def c_bands_ordered(scene: Scene) -> Frame:
    """Prepare `c_bands` on triangles in spatial order."""
    return _plain_c(scene, bands=True, ordered=True)


def _spatial_order(centers: NDArray[Any]) -> NDArray[np.int64]:
    low, high = centers.min(axis=0), centers.max(axis=0)
    cell = ((centers - low) / (high - low).max() * 1023).astype(np.uint32)
    key = np.zeros(len(cell), np.uint32)
    for bit in range(10):
        for axis in range(3):
            key |= (cell[:, axis] >> bit & 1) << np.uint32(3 * bit + axis)
    return np.argsort(key, kind="stable")


def _projection() -> NDArray[np.float32]:
    """Return the clip matrix of the camera, column-major as in OpenGL."""
    p = np.zeros((4, 4))
    p[0, 0], p[1, 1] = 2 * FOCAL / WIDTH, 2 * FOCAL / HEIGHT
    p[2, 2], p[2, 3] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    p[3, 2] = -1
    return np.ascontiguousarray((p @ np.diag([1, -1, -1, 1]) @ pose()).T, np.float32)


def vtk(scene: Scene) -> Frame:
    """Prepare VTK through pyvista."""
    import pyvista as pv
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

    cells = np.concatenate([np.full((len(scene.indices), 1), 3), scene.indices], axis=1)
    mesh = pv.PolyData(scene.positions, cells.reshape(-1))
    mesh.point_data["rgb"] = scene.colors[:, :3]
    plotter = pv.Plotter(off_screen=True, window_size=(WIDTH, HEIGHT), lighting=None)
    plotter.add_mesh(mesh, scalars="rgb", rgb=True, lighting=False)
    plotter.background_color = "black"
    window = plotter.render_window
    window.SetMultiSamples(0)
    view = pose()
    center = -view[:3, :3].T @ view[:3, 3]
    plotter.camera.position = center
    plotter.camera.focal_point = center + view[2, :3]
    plotter.camera.up = -view[1, :3]
    plotter.camera.view_angle = np.degrees(2 * np.arctan(HEIGHT / 2 / FOCAL))
    plotter.camera.clipping_range = (NEAR, FAR)
    plotter.show(auto_close=False)
    pixels = vtkUnsignedCharArray()

    def frame() -> NDArray[Any]:
        window.Render()
        window.GetPixelData(0, 0, WIDTH - 1, HEIGHT - 1, 0, pixels, 0)
        return vtk_to_numpy(pixels).reshape(HEIGHT, WIDTH, 3)[::-1]

    return frame


def moderngl(scene: Scene) -> Frame:
    """Prepare OpenGL through moderngl and EGL."""
    import moderngl as gl

    context = gl.create_context(standalone=True, backend="egl")
    program = context.program(
        vertex_shader="""
            #version 330
            uniform mat4 camera; in vec3 place; in vec4 color; out vec4 shade;
            void main() { gl_Position = camera * vec4(place, 1.0); shade = color; }""",
        fragment_shader="""
            #version 330
            in vec4 shade; out vec4 target; void main() { target = shade; }""",
    )
    program["camera"].write(_projection().tobytes())
    content = [
        (context.buffer(scene.positions.tobytes()), "3f", "place"),
        (context.buffer(scene.colors.tobytes()), "4f1", "color"),
    ]
    index = context.buffer(scene.indices.tobytes()) if scene.shared else None
    array = context.vertex_array(program, content, index_buffer=index)
    target = context.framebuffer(
        context.renderbuffer((WIDTH, HEIGHT), 4), context.depth_renderbuffer((WIDTH, HEIGHT))
    )
    target.use()
    context.enable_only(gl.DEPTH_TEST)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    def frame() -> NDArray[Any]:
        target.clear(0.0, 0.0, 0.0, 1.0)
        array.render(gl.TRIANGLES)
        target.read_into(image, components=3, alignment=1)
        return image[::-1]

    return frame


def engine(name: str) -> Callable[[Scene], Frame]:
    """Return the peer for one of our engine renderers. Its frame has image and depth as floats."""

    def prepare(scene: Scene) -> Frame:
        from msb.render.backend import find_renderer

        renderer = find_renderer(name)(_asset(scene))
        camera = _camera()

        def frame() -> NDArray[Any]:
            return renderer.render(camera, (0.0, 0.0, 0.0)).image

        frame.about = {"version": renderer.version, **renderer.device_info}
        return frame

    return prepare


def _rays() -> NDArray[np.float32]:
    view = pose()
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    local = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], axis=-1)
    world = local.reshape(-1, 3) @ view[:3, :3]
    origin = np.broadcast_to(-view[:3, :3].T @ view[:3, 3], world.shape)
    return np.concatenate([origin, world], axis=1).astype(np.float32)


def embree_open3d(scene: Scene) -> Frame:
    """Prepare Embree through Open3D.

    It finds the hit face and the distance of each ray. It computes no colours.
    """
    import open3d

    caster = open3d.t.geometry.RaycastingScene()
    corners, faces = (open3d.core.Tensor(np.ascontiguousarray(a)) for a in (scene.positions, scene.indices))
    caster.add_triangles(corners, faces)
    rays = open3d.core.Tensor(_rays())

    def frame() -> None:
        caster.cast_rays(rays)

    return frame


def embree(scene: Scene) -> Frame:
    """Prepare Embree through embreex.

    It finds the hit face of each ray, in one thread. It computes no colours.
    """
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    rays = _rays()
    caster = EmbreeScene()
    TriangleMesh(caster, scene.positions[scene.indices])
    origin, direction = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])

    def frame() -> None:
        caster.run(origin, direction, output=0)

    return frame


PEERS: dict[str, tuple[str, Callable[[Scene], Frame]]] = {
    "msb": ("the image, float32 RGB", msb),
    "msb textured": (
        f"the image, with a texture of {TEXELS} x {TEXELS} instead of vertex colours",
        msb_textured,
    ),
    "msb frame": ("image, coverage, depth, face ids", msb_frame),
    "c direct": ("plain C, OpenMP, 64-bit keys and atomics", c_direct),
    "c bands": ("plain C, OpenMP, triangles listed by bands of 16 rows", c_bands),
    "c direct sorted": ("c direct, triangles in spatial order", c_direct_ordered),
    "c bands sorted": ("c bands, triangles in spatial order", c_bands_ordered),
    "vtk": ("VTK by pyvista, OpenGL", vtk),
    "moderngl": ("OpenGL by EGL", moderngl),
    "wgpu": ("renderer wgpu: Vulkan", engine("wgpu")),
    "threejs": ("renderer threejs: three.js in a headless browser", engine("threejs")),
    "blender_workbench": ("renderer blender_workbench: OpenGL", engine("blender_workbench")),
    "blender_cycles": ("renderer blender_cycles: rays", engine("blender_cycles")),
    "embree open3d": ("Embree by Open3D, rays alone, no colours", embree_open3d),
    "embree": ("Embree by embreex, rays alone, one thread, no colours", embree),
}
"""Descriptions and peers by name."""
