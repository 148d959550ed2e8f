"""DiffSoup: free triangles with lattices of features and opacity, and a decoder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training import diffsoup, losses
from data_stubs.training.files import write_diffsoup
from data_stubs.training.lattice import lattice_nodes, node_count, refinement, sampled
from data_stubs.training.model import Model, Statistics, between, geometric, worst
from data_stubs.training.start import chosen, pixel_sizes, triangles_at
from msb.methods.diffsoup.reference import LAYERS

if TYPE_CHECKING:
    from data_stubs.training.drawing import Drawn
    from msb.scenes import Camera

_START, _GROWN, _LAST_CHANGE = 0.5, 0.4, 0.5
_BINARY = 0.75
"""After this share of the training, images are drawn as in evaluation, with opacity cut at 0.5."""
MIN_PEAK = 0.05
MIN_EDGE = 4.0
_NEAR_FAR = {"colmap": (0.5, 100.0), "synthetic": (0.1, 10.0)}


class DiffSoup(Model):
    """Positions, lattices of eight logits, and the decoder.

    Each lattice is the sum of a coarse and a fine one; official lattices have several levels. The training is
    simpler than the official one. Random thresholds are replaced by the expected image (`diffsoup.draw`), and
    triangles with the largest errors are split at their longest edge. After three quarters of the training
    opacity is cut at 0.5, and only features and decoder are optimised.
    """

    method = "diffsoup"

    @property
    def faces(self) -> int:
        return len(self.parameters["V"])

    @property
    def _level(self) -> int:
        return self.options.level

    def start(self) -> dict[str, torch.Tensor]:
        points, colors = chosen(
            self.capture.points, self.capture.colors, int(_START * self.options.faces), self.random
        )
        triangles = triangles_at(points, 1.2, self.random).astype(np.float32)
        clear = np.clip(colors, 0.02, 0.98)
        coarse = np.zeros((len(triangles), 3, 8), np.float32)
        coarse[..., :3] = np.log(clear / (1 - clear))[:, None]
        coarse[..., 3] = -2
        coarse[..., 7] = 1
        found = {
            "V": torch.from_numpy(triangles),
            "coarse": torch.from_numpy(coarse),
            "fine": torch.zeros((len(triangles), node_count(self._level), 8)),
        }
        for layer, (outputs, inputs) in LAYERS.items():
            weight = self.random.normal(0, (2 / inputs) ** 0.5, (outputs, inputs))
            found[f"{layer}.weight"] = torch.from_numpy(weight.astype(np.float32))
            found[f"{layer}.bias"] = torch.zeros(outputs)
        self._pixel = pixel_sizes(points, self.cameras)
        return found

    def settings(self, progress: float) -> dict[str, Any]:
        layout = "synthetic" if self.capture.synthetic else "colmap"
        near, far = _NEAR_FAR[layout]
        return {"layout": layout, "z_near": near, "z_far": far}

    def values(self) -> dict[str, torch.Tensor]:
        """Return the parameters of the official file."""
        logits = refinement(0, self._level) @ self.parameters["coarse"] + self.parameters["fine"]
        table = logits.sigmoid()
        found = {name: p for name, p in self.parameters.items() if name not in ("coarse", "fine")}
        places = self.parameters["V"].reshape(-1, 3)
        return found | {"V": places, "feat_acc": table[..., :7], "alpha_acc": table[..., 7:]}

    def draw(
        self, camera: Camera, settings: Mapping[str, Any], photograph: torch.Tensor | None = None
    ) -> Drawn:
        indices = np.arange(3 * self.faces).reshape(-1, 3)
        background = self.capture.background
        return diffsoup.draw(self.values(), indices, self._level, camera, background, settings, photograph)

    def loss(
        self, camera: Camera, photograph: losses.Photograph, progress: float
    ) -> tuple[torch.Tensor, Drawn]:
        if progress >= _BINARY:
            return super().loss(camera, photograph, progress)
        drawn: Any = self.draw(camera, self.settings(progress), photograph.image)
        structural = losses.dssim(drawn.image, photograph)
        return (1 - losses.SHARE) * drawn.l1 + losses.SHARE * structural, drawn

    def rates(self, progress: float) -> dict[str, Any]:
        slower = geometric(1, 0.1, between(progress, _BINARY, 1))
        places = geometric(0.2, 0.02, progress) if progress < _BINARY else 0.0
        found: dict[str, Any] = dict.fromkeys(self.parameters, 0.003 * slower)
        found["V"] = torch.from_numpy(self._pixel)[:, None, None] * places
        found["coarse"] = found["fine"] = 0.03 * slower
        return found

    def restructure(self, progress: float, seen: Statistics) -> None:
        if progress > _LAST_CHANGE:
            return
        kept = np.flatnonzero(seen.peak > MIN_PEAK)
        corners = self.parameters["V"].detach().numpy()[kept]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        wide = edges.max(axis=1) > MIN_EDGE * self._pixel[kept]
        grown = between(progress, 0, _GROWN)
        target = self.options.faces * (_START + (1 - _START) * grown)
        split = worst(seen.error[kept], wide, int(target - len(kept)), self.random)
        stay = np.setdiff1d(np.arange(len(kept)), split)
        with torch.no_grad():
            logits = refinement(0, self._level) @ self.parameters["coarse"] + self.parameters["fine"]
        halves, lattices = halved(
            corners[split], logits[torch.from_numpy(kept[split])], edges[split].argmax(axis=1), self._level
        )
        new = {"V": halves, "coarse": torch.zeros((len(halves), 3, 8)), "fine": lattices}
        rows = torch.from_numpy(kept[stay])
        for name, value in new.items():
            old = self.parameters[name].detach()[rows]
            self.adam.rebuild(name, torch.cat([old, value]), kept[stay])
        self._measure()

    def _measure(self) -> None:
        middle = self.parameters["V"].detach().double().mean(1).numpy()
        self._pixel = pixel_sizes(middle, self.cameras)

    def structure(self) -> dict[str, NDArray[Any]]:
        return {"pixel": self._pixel}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        super().restore(state)
        self._pixel = state["pixel"]

    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        with torch.no_grad():
            values = {name: value.numpy() for name, value in self.values().items()}
        one = self.cameras[0]
        colmap = settings["layout"] == "colmap"
        lens = {"K": one.K.astype(np.float32)} if colmap else {}
        decoder = {
            f"{layer}.{part}": values[f"{layer}.{part}"] for layer in LAYERS for part in ("weight", "bias")
        }
        document = {
            "feat_acc": np.ascontiguousarray(values["feat_acc"]),
            "alpha_acc": np.ascontiguousarray(values["alpha_acc"]),
            "V": values["V"],
            "F": np.arange(3 * self.faces, dtype=np.int32).reshape(-1, 3),
            "color_mlp": decoder,
            "Rmin": 0,
            "Rmax": self._level,
            "feat_dim": 7,
            **lens,
            "H": one.height,
            "W": one.width,
            **({"flip_z": True} if colmap else {}),
            "steps": iteration,
            "losses": [],
            "seed": self.options.seed,
        }
        write_diffsoup(folder, document)


def halved(
    corners: NDArray[np.float32], lattices: torch.Tensor, longest: NDArray[np.int64], level: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return triangles (2 N, 3, 3) and lattices (2 N, S, 8) split at the middle of an edge."""
    nodes = torch.from_numpy(lattice_nodes(level)).float()
    places = torch.zeros((len(corners), 2, 3, 3))
    values = torch.zeros((len(corners), 2, *lattices.shape[1:]))
    for edge in range(3):
        chosen_ones = torch.from_numpy(np.flatnonzero(longest == edge))
        following = (edge + 1) % 3
        for half, moved in enumerate((following, edge)):
            # Corners of a half in barycentric coordinates of the whole triangle: one end of the edge becomes
            # its middle.
            weights = torch.eye(3)
            weights[moved] = 0
            weights[moved, [edge, following]] = 0.5
            places[chosen_ones, half] = weights @ torch.from_numpy(corners)[chosen_ones]
            values[chosen_ones, half] = sampled((nodes @ weights).numpy(), level) @ lattices[chosen_ones]
    return places.flatten(0, 1), values.flatten(0, 1)
