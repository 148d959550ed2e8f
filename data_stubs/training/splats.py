"""3DGS and 2DGS: anisotropic Gaussians or flat discs, each with its opacity and colour."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from data_stubs.training import disc_splatting, gaussian_splatting
from data_stubs.training.files import write_gaussians
from data_stubs.training.model import Model, Statistics, between, geometric, worst
from data_stubs.training.start import chosen, color_coefficients, fit_planes, pixel_sizes

if TYPE_CHECKING:
    from data_stubs.training.drawing import Drawn
    from msb.scenes import Camera

# Share of the Gaussians that exist at the start, if the scene has enough points.
_START = 0.5
# Share of the training after which all Gaussians exist, and after which their number stays.
_GROWN, _LAST_CHANGE = 0.5, 0.8
# A Gaussian is removed if its weight never exceeds this value.
_MIN_PEAK = 0.02
_OPACITY = 0.5
# Deviation of a Gaussian at the start, relative to the distances of its nearest points.
_SIZE = 0.5
# Both halves of a split Gaussian are smaller by this factor, as in 3DGS.
_SHRINK = 1.6


class GaussianSplatting(Model):
    """Means, scales, rotations, opacities and SH.

    The training is simpler than that of 3DGS. Gaussians that contribute little are removed. Others are drawn
    with probabilities proportional to their errors, and split into two at random points inside them.
    """

    method = "three_dgs"

    @property
    def faces(self) -> int:
        return len(self.parameters["xyz"])

    def start(self) -> dict[str, torch.Tensor]:
        points, colors = chosen(
            self.capture.points, self.capture.colors, int(_START * self.options.faces), self.random
        )
        distances = cKDTree(points).query(points, min(4, len(points)))[0][:, 1:].mean(axis=1)
        count, coefficients = len(points), (self.options.sh_degree + 1) ** 2 - 1
        self._measure(points)
        scale = np.log(_SIZE * distances).astype(np.float32)[:, None].repeat(3, axis=1)
        return {
            "xyz": torch.from_numpy(points.astype(np.float32)),
            "f_dc": torch.from_numpy(color_coefficients(colors)),
            "f_rest": torch.zeros((count, coefficients, 3)),
            "opacity": torch.full((count, 1), math.log(_OPACITY / (1 - _OPACITY))),
            "scale": torch.from_numpy(scale),
            "rotation": torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        }

    def _measure(self, points: NDArray[Any]) -> None:
        """Store the size of a pixel at each Gaussian; steps of positions are relative to this size."""
        self._pixel = pixel_sizes(points.astype(np.float64), self.cameras)

    def settings(self, progress: float) -> dict[str, Any]:
        return {"sh_degree": self.options.sh_degree}

    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        return gaussian_splatting.draw(self.parameters, camera, self.capture.background, settings)

    def rates(self, progress: float) -> dict[str, Any]:
        slower = geometric(1, 0.1, between(progress, 0.6, 1))
        pixel = torch.from_numpy(self._pixel)[:, None]
        return {
            "xyz": pixel * geometric(0.25, 0.01, progress),
            "scale": 0.02 * slower,
            "rotation": 0.01 * slower,
            "opacity": 0.04 * slower,
            "f_dc": 0.015 * slower,
            "f_rest": 0.001 * slower,
        }

    def restructure(self, progress: float, seen: Statistics) -> None:
        if progress > _LAST_CHANGE:
            return
        kept = np.flatnonzero(seen.peak > _MIN_PEAK)
        grown = between(progress, 0, _GROWN)
        target = self.options.faces * (_START + (1 - _START) * grown)
        split = worst(seen.error[kept], np.ones(len(kept), bool), int(target - len(kept)), self.random)
        stay = np.setdiff1d(np.arange(len(kept)), split)
        halves = self._sample_inside(kept[split])
        for name, parameter in list(self.parameters.items()):
            old = parameter.detach()[torch.from_numpy(kept)]
            new = old[torch.from_numpy(split)].repeat_interleave(2, 0)
            if name == "xyz":
                new = halves
            elif name == "scale":
                new = new - math.log(_SHRINK)
            self.adam.rebuild(name, torch.cat([old[torch.from_numpy(stay)], new]), kept[stay])
        self._measure(self.parameters["xyz"].detach().numpy())

    def _sample_inside(self, faces: NDArray[np.int64]) -> torch.Tensor:
        """Return two random points (2 n, 3) of each of the Gaussians `faces` (n,)."""
        chosen = torch.from_numpy(faces)
        mean, scale, rotation = (
            self.parameters[name].detach()[chosen].repeat_interleave(2, 0)
            for name in ("xyz", "scale", "rotation")
        )
        offsets = torch.zeros((len(mean), 3))
        normal = self.random.normal(size=scale.shape).astype(np.float32)
        offsets[:, : scale.shape[1]] = torch.from_numpy(normal) * scale.exp()
        turned = gaussian_splatting.rotation_matrices(rotation) @ offsets[..., None]
        return mean + turned[..., 0]

    def structure(self) -> dict[str, NDArray[Any]]:
        return {"pixel": self._pixel}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        super().restore(state)
        self._pixel = state["pixel"]

    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        values = {name: p.detach().numpy() for name, p in self.parameters.items()}
        write_gaussians(folder, iteration, values, self.capture, settings["sh_degree"])


class DiscSplatting(GaussianSplatting):
    """2DGS: flat Gaussians, which are tangent to the surface through the points at the start.

    The training has no distortion loss and no normal loss.
    """

    method = "two_dgs"

    def start(self) -> dict[str, torch.Tensor]:
        found = super().start()
        points = found["xyz"].double().numpy()
        rotation = Rotation.from_matrix(fit_planes(points)).as_quat(scalar_first=True)
        found["rotation"] = torch.from_numpy(rotation.astype(np.float32))
        found["scale"] = found["scale"][:, :2].contiguous()
        return found

    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        return disc_splatting.draw(self.parameters, camera, self.capture.background, settings)
