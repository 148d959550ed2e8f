"""Triangle-Splatting and 2DTS: unconnected triangles, each with its opacity and colour."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training import triangle_splatting, two_dts
from data_stubs.training.files import write_2dts, write_state_dict
from data_stubs.training.model import Model, Statistics, between, geometric, worst
from data_stubs.training.start import chosen, color_coefficients, pixel_sizes, triangles_at

if TYPE_CHECKING:
    from data_stubs.training.drawing import Drawn
    from msb.scenes import Camera

_START = 0.5
"""Share of the triangles that exist at the start, if the scene has enough points."""
_GROWN = 0.5
"""Share of the training after which all triangles exist."""
_LAST_CHANGE = 0.8
MIN_PEAK = 0.02
"""A triangle is removed if its weight never exceeds this value (Triangle-Splatting: threshold 0.022)."""


class Soup(Model):
    """A soup of N triangles. Their corners are the parameter named `corners`, (N, 3, 3).

    The training is simpler than that of Triangle-Splatting. Triangles that contribute little are removed.
    Other triangles are drawn with probabilities proportional to their errors, and split into four at their
    edge midpoints.
    """

    corners: str
    opacity: str
    color: str
    rest: str
    opacity_start: float
    size_start: float
    min_edge: float
    """Only triangles whose longest edge has at least this length in pixels are split."""

    @property
    def faces(self) -> int:
        return len(self.parameters[self.corners])

    @abstractmethod
    def more(self, count: int) -> dict[str, torch.Tensor]:
        """Return the other initial parameters of `count` triangles."""

    def start(self) -> dict[str, torch.Tensor]:
        points, colors = chosen(
            self.capture.points, self.capture.colors, int(_START * self.options.faces), self.random
        )
        triangles = triangles_at(points, self.size_start, self.random).astype(np.float32)
        count = len(triangles)
        logit = math.log(self.opacity_start / (1 - self.opacity_start))
        higher = (self.options.sh_degree + 1) ** 2 - 1
        self._measure(triangles)
        return {
            self.corners: torch.from_numpy(triangles),
            self.opacity: torch.full((count, 1), logit),
            self.color: torch.from_numpy(color_coefficients(colors)),
            self.rest: torch.zeros((count, higher, 3)),
            **self.more(count),
        }

    def _measure(self, triangles: NDArray[np.float32]) -> None:
        """Store the size of a pixel at each triangle; steps of positions are relative to this size."""
        self._pixel = pixel_sizes(triangles.mean(axis=1).astype(np.float64), self.cameras)

    def rates(self, progress: float) -> dict[str, Any]:
        slower = geometric(1, 0.1, between(progress, 0.6, 1))
        pixel = torch.from_numpy(self._pixel)[:, None, None]
        return {
            self.corners: pixel * geometric(0.25, 0.01, progress),
            self.opacity: 0.04 * slower,
            self.color: 0.015 * slower,
            self.rest: 0.001 * slower,
        }

    def restructure(self, progress: float, seen: Statistics) -> None:
        if progress > _LAST_CHANGE:
            return
        kept = np.flatnonzero(seen.peak > MIN_PEAK)
        corners = self.parameters[self.corners].detach().numpy()[kept]
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        wide = edges > self.min_edge * self._pixel[kept]
        grown = between(progress, 0, _GROWN)
        target = self.options.faces * (_START + (1 - _START) * grown)
        split = worst(seen.error[kept], wide, int((target - len(kept)) / 3), self.random)
        stay = np.setdiff1d(np.arange(len(kept)), split)
        parts = quartered(corners[split])
        for name, parameter in list(self.parameters.items()):
            old = parameter.detach()[torch.from_numpy(kept)]
            new = old[torch.from_numpy(split)].repeat_interleave(4, 0)
            if name == self.corners:
                new = torch.from_numpy(parts)
            self.adam.rebuild(name, torch.cat([old[torch.from_numpy(stay)], new]), kept[stay])
        self._measure(self.parameters[self.corners].detach().numpy())

    def structure(self) -> dict[str, NDArray[Any]]:
        return {"pixel": self._pixel}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        super().restore(state)
        self._pixel = state["pixel"]


def quartered(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Split each triangle into four at its edge midpoints, (4 N, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, 1) for part in parts], 1).reshape(-1, 3, 3)


class TriangleSplatting(Soup):
    """Positions, opacity, sigma and SH of each triangle."""

    method = "triangle_splatting"
    corners, opacity, color, rest = "triangles_points", "opacity", "features_dc", "features_rest"
    opacity_start, size_start, min_edge = 0.5, 1.4, 6.0

    def more(self, count: int) -> dict[str, torch.Tensor]:
        return {"sigma": torch.full((count, 1), math.log(0.7))}

    def settings(self, progress: float) -> dict[str, Any]:
        return {"sh_degree": self.options.sh_degree, "view_dir": "broadcast_z"}

    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        return triangle_splatting.draw(self.parameters, camera, self.capture.background, settings)

    def rates(self, progress: float) -> dict[str, Any]:
        found = super().rates(progress)
        return found | {"sigma": found[self.opacity] / 4}

    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        values = {name: p.detach().numpy() for name, p in self.parameters.items()}
        values = {
            "triangles_points": values["triangles_points"],
            "sigma": values["sigma"],
            "active_sh_degree": settings["sh_degree"],
            "features_dc": values["features_dc"],
            "features_rest": values["features_rest"],
            "opacity": values["opacity"],
        }
        write_state_dict(folder, iteration, values, self.capture, self.options.sh_degree)


class TwoDTS(Soup):
    """Positions, opacity and SH of each triangle, and one gamma that is annealed from 1 to hard edges."""

    method = "two_dts"
    corners, opacity, color, rest = "_vertex", "_opacity", "_f_dc", "_f_rest"
    opacity_start, size_start, min_edge = 0.5, 0.7, 3.0

    def more(self, count: int) -> dict[str, torch.Tensor]:
        return {}

    def settings(self, progress: float) -> dict[str, Any]:
        return {
            "rasterizer": self.options.rasterizer,
            "sh_degree": self.options.sh_degree,
            "gamma": geometric(1, self.options.gamma, between(progress, 0.3, 0.8)),
            "back_culling": False,
            "gamma_rescale": True,
            "ste_threshold": None,
            "render_up_scale": None,
        }

    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        return two_dts.draw(self.parameters, camera, self.capture.background, settings)

    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        values = {name: p.detach().numpy() for name, p in self.parameters.items()}
        write_2dts(folder, iteration, values, settings, self.capture)
