"""MeshSplatting: triangles with shared vertices, opaque at the end of training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from data_stubs.training import mesh_splatting
from data_stubs.training.files import write_state_dict
from data_stubs.training.model import Model, Options, Statistics, between, geometric, worst
from data_stubs.training.start import chosen, color_coefficients, pixel_sizes, spread_out

if TYPE_CHECKING:
    from data_stubs.training.drawing import Drawn
    from data_stubs.training.scene import Capture
    from msb.scenes import Camera

_START_VERTICES = 0.35
"""Initial vertices per final triangle."""
_START_FACES = 0.8
_MOST_POINTS = 50_000
_LONGEST = 4.0
"""Longest edge of an initial triangle, relative to the mean edge length around it."""
_GROWN, _LAST_CHANGE = 0.6, 0.75
_AT_REST, _OPAQUE = 0.35, 0.7
"""After these shares of the training, positions are frozen, and faces are opaque with hard edges.


Derivatives by position ignore the background that appears when an edge moves. With hard edges, steps along
them increase the loss.
"""
_NEIGHBOURS = 14
MIN_PEAK = 0.1
MIN_EDGE = 2.5
"""Shortest edge that is split, in pixels."""
FINEST = 4
"""Samples per pixel along each axis in the official evaluation."""


class MeshSplatting(Model):
    """Positions, opacity and SH of shared vertices.

    The training is simpler than the official one. It starts from a surface through the points, drops faces
    that contribute little, and splits the longest edges of faces with large errors. All faces at an edge are
    split together, so connected faces stay connected.
    """

    method = "mesh_splatting"

    def __init__(self, capture: Capture, options: Options) -> None:
        self.indices = np.zeros((0, 3), np.int64)
        super().__init__(capture, options)

    @property
    def faces(self) -> int:
        return len(self.indices)

    def start(self) -> dict[str, torch.Tensor]:
        limit = max(int(_START_VERTICES * self.options.faces), 16)
        points, colors = chosen(self.capture.points, self.capture.colors, _MOST_POINTS, self.random)
        spread = spread_out(points, pixel_sizes(points, self.cameras), limit, self.random)
        points, colors = points[spread], colors[spread]
        self.indices = surface_like(points, int(_START_FACES * self.options.faces))
        used, self.indices = _used(self.indices)
        points, colors = points[used], colors[used]
        higher = (self.options.sh_degree + 1) ** 2 - 1
        self._pixel = pixel_sizes(points, self.cameras)
        return {
            "triangles_points": torch.from_numpy(points.astype(np.float32)),
            "vertex_weight": torch.full((len(points), 1), 0.5),
            "features_dc": torch.from_numpy(color_coefficients(colors)),
            "features_rest": torch.zeros((len(points), higher, 3)),
        }

    def settings(self, progress: float) -> dict[str, Any]:
        opaque = between(progress, 0.05, _OPAQUE)
        return {
            "sh_degree": self.options.sh_degree,
            "supersample": FINEST if progress >= 0.9 else 2,
            "opacity_floor": 0.999 * opaque,
            "sigma": geometric(1.0, 1e-4, opaque),
        }

    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        return mesh_splatting.draw(self.parameters, self.indices, camera, self.capture.background, settings)

    def rates(self, progress: float) -> dict[str, Any]:
        slower = geometric(1, 0.1, between(progress, 0.7, 1))
        moved = geometric(0.25, 0.003, progress / _AT_REST) if progress < _AT_REST else 0.0
        return {
            "triangles_points": torch.from_numpy(self._pixel)[:, None] * moved,
            "vertex_weight": 0.04 * slower,
            "features_dc": 0.015 * slower,
            "features_rest": 0.001 * slower,
        }

    def restructure(self, progress: float, seen: Statistics) -> None:
        if progress > _LAST_CHANGE:
            return
        places = self.parameters["triangles_points"].detach().numpy()
        edges = np.linalg.norm(places[self.indices] - places[np.roll(self.indices, -1, axis=1)], axis=2)
        wide = edges.max(axis=1) > MIN_EDGE * self._pixel[self.indices].mean(axis=1)
        # A small triangle that lies between samples is kept, because it belongs to the surface.
        kept = (seen.peak > MIN_PEAK) | ~wide
        faces, error, edges, wide = self.indices[kept], seen.error[kept], edges[kept], wide[kept]
        grown = between(progress, 0, _GROWN)
        target = self.options.faces * (_START_FACES + (1 - _START_FACES) * grown)
        wanted = max(int(target) - len(faces), 0)
        first = worst(error, wide, wanted // 2, self.random)
        faces, middles = split_edges(faces, edges.argmax(axis=1), first, len(places))
        used, self.indices = _used(faces)
        old = used[used < len(places)]
        ends = torch.from_numpy(middles[used[used >= len(places)] - len(places)])
        for name, parameter in list(self.parameters.items()):
            values = parameter.detach()
            new = values[ends].mean(1) if len(ends) else values[:0]
            self.adam.rebuild(name, torch.cat([values[torch.from_numpy(old)], new]), old)
        self._measure()

    def _measure(self) -> None:
        places = self.parameters["triangles_points"].detach().double().numpy()
        self._pixel = pixel_sizes(places, self.cameras)

    def structure(self) -> dict[str, NDArray[Any]]:
        return {"indices": self.indices, "pixel": self._pixel}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        super().restore(state)
        self.indices, self._pixel = state["indices"], state["pixel"]

    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        values = {name: p.detach().numpy() for name, p in self.parameters.items()}
        document = {
            "triangles_points": values["triangles_points"],
            "_triangle_indices": self.indices.astype(np.int32),
            "vertex_weight": values["vertex_weight"],
            "sigma": math.log(settings["sigma"]),
            "active_sh_degree": settings["sh_degree"],
            "features_dc": values["features_dc"],
            "features_rest": values["features_rest"],
            "importance_score": np.ones(self.faces, np.float32),
            "image_size": np.zeros(self.faces, np.float32),
            "pixel_count": np.zeros(self.faces, np.int32),
        }
        write_state_dict(folder, iteration, document, self.capture, self.options.sh_degree)


def surface_like(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return at most `count` triangles that connect points (N, 3) to a surface.

    The neighbourhood of each point is triangulated in its tangent plane (Delaunay). A triangle that is found
    from at least two of its corners is preferred. Next, triangles with shorter edges relative to the local
    spacing are preferred.
    """
    distances, near = cKDTree(points).query(points, min(_NEIGHBOURS + 1, len(points)))
    around = points[near] - points[:, None]
    centered = around - around.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(centered.transpose(0, 2, 1) @ centered)
    flat = around @ axes[:, :, 1:]
    found = []
    for members, places in zip(near, flat, strict=True):
        fan = Delaunay(places, qhull_options="QJ").simplices
        found.append(members[fan[(fan == 0).any(axis=1)]])
    faces, votes = np.unique(np.sort(np.concatenate(found), axis=1), axis=0, return_counts=True)
    edges = np.linalg.norm(points[faces] - points[np.roll(faces, -1, axis=1)], axis=2)
    ratio = edges.max(axis=1) / distances[faces, 1:4].mean(axis=(1, 2))
    likely = ratio * np.where(votes >= 2, 1, 2)
    order = np.argsort(likely, kind="stable")[:count]
    return np.sort(faces[order[likely[order] <= _LONGEST]], axis=1)


def split_edges(
    faces: NDArray[np.int64], longest: NDArray[np.int64], first: NDArray[np.int64], vertices: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split the longest edges of the faces `first`, and all faces at these edges; no face is split twice.

    Returns
    -------
    faces : (F', 3)
        New vertices are numbered from `vertices`.
    middles : (M, 2)
        The two vertices of each split edge.
    """
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    _, edge = np.unique(ends[:, 0] * vertices + ends[:, 1], return_inverse=True)
    at = np.argsort(edge, kind="stable")
    starts = np.searchsorted(edge[at], np.arange(edge.max(initial=-1) + 2))
    taken = np.full(len(faces), -1)  # the number of the new vertex on each split face, and -1 for other faces
    side = np.zeros(len(faces), np.int64)
    middles = []
    for face in first.tolist():
        mine = 3 * face + longest[face]
        around = at[starts[edge[mine]] : starts[edge[mine] + 1]]
        if (taken[around // 3] < 0).all():
            taken[around // 3] = len(middles)
            side[around // 3] = around % 3
            middles.append(ends[mine])
    split = np.flatnonzero(taken >= 0)
    new = vertices + taken[split]
    a, b, c = (faces[split, (side[split] + k) % 3] for k in range(3))
    parts = np.stack([np.stack([a, new, c], 1), np.stack([new, b, c], 1)], 1).reshape(-1, 3)
    return np.concatenate([faces[taken < 0], parts]), np.array(middles, np.int64).reshape(-1, 2)


def _used(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the used vertices, and the faces with indices into them."""
    used, numbers = np.unique(faces, return_inverse=True)
    return used, numbers.reshape(-1, 3)
