"""Meshes, cameras and renderers for the tests of the standard tier."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset, Description, build_asset
from msb.cl import Device
from msb.reference import ReferenceFrame
from msb.render import Frame
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from tests.reference.standard import render_standard
from tests.render.frames import frame_of

Arrays = tuple[NDArray[np.float32], NDArray[np.uint32]]

BACKGROUND = (0.1, 0.2, 0.3)
KINDS = ("small", "tiny", "large", "needles", "through the camera", "far and wide", "everything")


def camera(
    width: int = 83,
    height: int = 61,
    focal: float = 70.0,
    principal: tuple[float, float] | None = None,
    pose: Any = None,
) -> Camera:
    cx, cy = principal or (width / 2, height / 2)
    return Camera(width, height, focal, 1.03 * focal, cx, cy, np.eye(4) if pose is None else pose)


def unshared(triangles: NDArray[Any]) -> Arrays:
    """Return triangles (F, 3 corners, 3) as a triangle soup."""
    positions = np.ascontiguousarray(triangles, np.float32).reshape(-1, 3)
    return positions, np.arange(len(positions), dtype=np.uint32).reshape(-1, 3)


def scattered(seed: int, count: int, size: float, spread: float, depth: float) -> NDArray[np.float64]:
    random = np.random.default_rng(seed)
    center = random.normal(size=(count, 1, 3)) * spread + (0, 0, depth)
    return center + random.normal(size=(count, 3, 3)) * size


def scene(kind: str, seed: int) -> Arrays:
    """Return a triangle soup of a kind in `KINDS`, which covers many pixels of `camera`."""
    random = np.random.default_rng(seed)
    if kind == "small":
        return unshared(scattered(seed, 700, 0.08, 1, 4))
    if kind == "tiny":
        return unshared(scattered(seed, 900, 0.015, 0.8, 4))
    if kind == "large":
        return unshared(scattered(seed, 60, 1.2, 1, 4))
    if kind == "needles":
        triangles = scattered(seed, 300, 0.5, 1, 4)
        triangles[:, 2] = triangles[:, 1] + (triangles[:, 2] - triangles[:, 0]) * random.uniform(
            0, 0.05, (300, 1)
        )
        triangles[::7, 2] = triangles[::7, 1]
        return unshared(triangles)
    if kind == "through the camera":
        return unshared(scattered(seed, 200, 0.7, 1.2, 0))
    if kind == "far and wide":
        return unshared(scattered(seed, 150, 300, 1000, 0))
    parts = [scene(other, seed) for other in KINDS[:-1]]
    triangles = np.concatenate([part[0].reshape(-1, 3, 3) for part in parts])
    triangles = triangles[random.permutation(len(triangles))]
    triangles[50:60] = triangles[60:70][:, [1, 2, 0]]
    return unshared(triangles)


def random_colors(seed: int, count: int, dtype: Any = np.uint8) -> NDArray[Any]:
    random = np.random.default_rng(seed)
    if dtype == np.uint8:
        return random.integers(0, 256, (count, 3), dtype=np.uint8)
    return random.uniform(-0.2, 1.2, (count, 3)).astype(np.float32)


def mesh_asset(mesh: Arrays, colors: NDArray[Any] | None = None, domain: str = "vertex") -> Asset:
    buffers: dict[str, Any] = {"positions": mesh[0], "indices": mesh[1]}
    if colors is not None:
        buffers["color"] = colors
    description = Description(appearance={"kind": "none" if colors is None else "static_color"})
    return build_asset(buffers, {"color": domain} if colors is not None else {}, description)


def draw(device: Device, asset: Asset, view: Camera, supersample: int = 1, **settings: Any) -> Frame:
    options = {"settings": settings, "supersample": supersample}
    return frame_of(StandardRenderer, asset, device, view, BACKGROUND, **options)


def twin(mesh: Arrays, colors: NDArray[Any], view: Camera, domain: str = "vertex") -> ReferenceFrame:
    """Return the frame of the NumPy twin."""
    return render_standard(*mesh, colors, domain, view, BACKGROUND)


def check_agreement(
    frame: Frame, expected: ReferenceFrame, faces: float = 0.999, median: float = 1e-5
) -> None:
    """Compare a kernel's frame with the twin's, in detail at pixels that show the same face."""
    same = frame.face_id == expected.face_id
    assert same.mean() >= faces, f"{(~same).sum()} of {same.size} pixels show another face"
    # Float32 barycentric coordinates are least exact for needles and for faces seen nearly edge-on.
    difference = np.abs(frame.image - expected.image).max(axis=2)[same]
    assert (difference > 1 / 255).mean() <= 1e-3
    assert np.median(difference, axis=None) < median
    np.testing.assert_array_equal(frame.alpha, (frame.face_id >= 0).astype(np.float32))
    np.testing.assert_array_equal(frame.depth > 0, frame.face_id >= 0)
    hit = same & (expected.face_id >= 0)
    if hit.any():
        relative = np.abs(frame.depth - expected.depth)[hit] / expected.depth[hit]
        assert np.quantile(relative, 0.99) < 1e-4


def check_equal(first: Frame, other: Frame) -> None:
    """Compare frames of two kernel styles, which are equal except for rare rounding differences."""
    same = first.face_id == other.face_id
    assert same.mean() >= 0.9999
    np.testing.assert_allclose(first.depth[same], other.depth[same], rtol=1e-5)
    assert (np.abs(first.image - other.image).max(axis=2)[same] > 1e-4).mean() <= 1e-4
