"""Assets that gain PSNR without being the thing, and disturbed copies of assets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from msb.meshes import Mesh
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from msb.scenes.datasets import Scene
from msb.scenes.walk import find_target

QUARTER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""The rotation from y up to z up."""


def disturb(mesh: Mesh, number: int) -> tuple[Mesh, NDArray[np.float64]]:
    """Return a copy of a mesh and its matrix (4, 4): turned, small, large and moved, mirrored, or z up."""
    half, third = np.sqrt(0.5), 1 / 3
    turn = np.array([[half, -half, 0], [half, half, 0], [0, 0, 1]])
    axis = np.eye(3) - 2 * third * np.ones((3, 3))  # a reflection
    matrix = np.eye(4)
    matrix[:3, :3] = [turn, 0.01 * turn.T, 100 * turn @ QUARTER, axis @ turn, 3 * QUARTER][number]
    matrix[:3, 3] = [(0, 0, 0), (0, 0, 0), (500, -300, 20), (1, 2, 3), (10, 20, -30)][number]
    return replace(mesh, vertices=mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]), matrix


def card(scene: Scene, camera: Camera, depth: float) -> Mesh:
    """Return a rectangle with the photograph of a camera, which fills its image at this depth."""
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64)
    pixels = corners * (camera.width, camera.height)
    local = np.c_[(pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(4)] * depth
    pose = camera.camera_to_world
    image = (ground_truth(scene, camera) * 255 + 0.5).astype(np.uint8)
    return Mesh(
        local @ pose[:3, :3].T + pose[:3, 3],
        np.array([[0, 1, 2], [0, 2, 3]]),
        vertex_uvs=corners.astype(np.float32),
        textures=(image,),
    )


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Return textured meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        vertex_uvs=np.concatenate([mesh.vertex_uvs for mesh in meshes if mesh.vertex_uvs is not None]),
        textures=tuple(mesh.textures[0] for mesh in meshes),
        face_textures=np.repeat(np.arange(len(meshes), dtype=np.uint32), 2) if len(meshes) > 1 else None,
    )


def far(scene: Scene, camera: Camera) -> float:
    """Return the depth of the middle of the capture in a camera."""
    return float(
        (camera.world_to_camera[:3, :3] @ find_target(scene.train) + camera.world_to_camera[:3, 3])[2]
    )


def photograph_on_a_card(scene: Scene) -> Mesh:
    return card(scene, scene.train[0], far(scene, scene.train[0]))


def billboards(scene: Scene, share: float = 0.1) -> Mesh:
    """Return a card in front of every camera, held-out ones too, at this share of its distance."""
    return join([card(scene, camera, share * far(scene, camera)) for camera in (*scene.train, *scene.test)])


def sequence_of_planes(scene: Scene) -> Mesh:
    """Return the photographs on cards behind each other, like the frames of a film."""
    camera = scene.train[0]
    depths = far(scene, camera) * np.linspace(0.7, 1.3, len(scene.train))
    frames = [card(scene, camera, depth) for depth in depths]
    images = [card(scene, view, 1.0).textures for view in scene.train]
    return join([replace(frame, textures=image) for frame, image in zip(frames, images, strict=True)])


def dome(scene: Scene) -> Mesh:
    """Return a sphere around the cameras whose vertices have the colours of the nearest photograph."""
    n = 160
    v, u = np.meshgrid(np.linspace(0.01, np.pi - 0.01, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    directions = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1).reshape(-1, 3)
    middle = find_target(scene.train)
    cameras = [*scene.train, *scene.test]
    reach = 3 * max(np.linalg.norm(camera.center - middle) for camera in cameras)
    vertices = middle + reach * directions
    colors = np.full((len(vertices), 3), 128, np.uint8)
    axes = np.stack([camera.camera_to_world[:3, 2] for camera in cameras])
    nearest = (directions @ axes.T).argmax(axis=1)
    for number, camera in enumerate(cameras):
        pixels, depth = camera.project(vertices)
        inside = (
            (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1)
        )
        rows = np.flatnonzero(inside & (nearest == number))
        x, y = np.floor(pixels[rows]).astype(int).T
        colors[rows] = (ground_truth(scene, camera)[y, x] * 255).astype(np.uint8)
    a = (np.arange(n - 1)[:, None] * 2 * n + np.arange(2 * n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + 2 * n], 1), np.stack([a + 1, a + 2 * n + 1, a + 2 * n], 1)]
    )
    return Mesh(vertices, faces, colors)


def noise() -> Mesh:
    """Return a bumpy ball with random colours, which no photograph shows."""
    random = np.random.default_rng(0)
    n = 100
    v, u = np.meshgrid(np.linspace(0.01, np.pi - 0.01, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    directions = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1).reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * 2 * n + np.arange(2 * n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + 2 * n], 1), np.stack([a + 1, a + 2 * n + 1, a + 2 * n], 1)]
    )
    return Mesh(
        directions * random.uniform(0.95, 1.05, (len(directions), 1)),
        faces,
        random.integers(0, 256, (len(directions), 3), np.uint8),
    )


def room(seed: int = 5) -> Mesh:
    """Return a box, seen from inside, and four boxes on its floor, each face with its own blurred noise."""
    random = np.random.default_rng(seed)
    unit = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float64)
    sides = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    boxes = [unit * (5, 4, 2.6)]
    boxes += [unit * (0.6, 0.5, 0.7) + np.append(random.uniform(0.4, (4, 3)), 0) for _ in range(4)]
    faces = []
    for corners in (box[side] for box in boxes for side in sides):
        image = sum(
            zoom(random.normal(0.5 / 3, 0.12, (size, size, 3)), (256 / size, 256 / size, 1), order=1)
            for size in (8, 32, 128)
        )
        picture = (np.clip(image, 0, 1) * 255).astype(np.uint8)
        uvs = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
        corner_order = np.array([[0, 1, 2], [0, 2, 3]])
        faces.append(Mesh(corners, corner_order, vertex_uvs=uvs, textures=(picture,)))
    return join(faces)


def cameras_in_the_room(count: int) -> list[Camera]:
    """Return cameras on an ellipse in the room that look outwards."""
    angles = np.arange(count) * 2 * np.pi / count
    cameras = []
    for angle in angles:
        eye = np.array([2.5 + 1.2 * np.cos(angle), 2 + 0.9 * np.sin(angle), 1.5])
        aim = eye + np.array([np.cos(angle + 0.3), np.sin(angle + 0.3), -0.1])
        cameras.append(Camera.look_at(eye, aim, up=(0, 0, 1), width=480, height=360, fov_y=1.0))
    return cameras
