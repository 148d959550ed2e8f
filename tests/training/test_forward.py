"""What the trainer draws is what the reference draws, to rounding in double, on every golden view."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from data_stubs.training import diffsoup, mesh_splatting, triangle_splatting, two_dts
from tests.reference.golden import View, exported, golden_views, names, worst

METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")
VIEWS = [view for method in METHODS for view in golden_views(method)]


class Scene:
    """A golden view with the values of its file, float64."""

    def __init__(self, view: View) -> None:
        asset = exported(view.folder / "checkpoint")
        self.view, self.method = view, asset.manifest.method
        self.settings = {name: stored.value for name, stored in asset.manifest.settings.items()}
        self.settings |= view.settings
        self.level = asset.manifest.appearance.get("level", 0)
        self.indices = asset.buffers["indices"].astype(np.int64)
        self.values = _values(self.method, asset.buffers)
        self.background = np.array(view.background, np.float64)

    def parameters(self) -> dict[str, Any]:
        """Return fresh tensors that ask for derivatives."""
        return {name: torch.from_numpy(value).clone().requires_grad_() for name, value in self.values.items()}

    def draw(self, parameters: dict[str, Any], photograph: Any = None) -> Any:
        """Return what the trainer draws of `parameters`."""
        camera, background, settings = self.view.camera, self.background, self.settings
        if self.method == "diffsoup":
            return diffsoup.draw(
                parameters, self.indices, self.level, camera, background, settings, photograph
            )
        if self.method == "mesh_splatting":
            return mesh_splatting.draw(parameters, self.indices, camera, background, settings)
        draw = two_dts.draw if self.method == "two_dts" else triangle_splatting.draw
        return draw(parameters, camera, background, settings)


def _values(method: str, buffers: Any) -> dict[str, np.ndarray]:
    if method == "diffsoup":
        found = {
            "V": buffers["positions"],
            "feat_acc": buffers["features.lattice"],
            "alpha_acc": buffers["features.opacity"][..., None],
        }
        found |= {k.removeprefix("decoder."): v for k, v in buffers.items() if k.startswith("decoder.")}
    else:
        rows = len(buffers["opacity"])
        shared = method == "mesh_splatting"
        places = buffers["positions"] if shared else buffers["positions"].reshape(rows, 3, 3)
        rest = buffers["f_rest"].reshape(rows, -1, 3) if "f_rest" in buffers else np.zeros((rows, 0, 3))
        names = {
            "two_dts": ("_vertex", "_opacity", "_f_dc", "_f_rest"),
            "triangle_splatting": ("triangles_points", "opacity", "features_dc", "features_rest"),
            "mesh_splatting": ("triangles_points", "vertex_weight", "features_dc", "features_rest"),
        }[method]
        parts = (places, buffers["opacity"][:, None], buffers["f_dc"][:, None], rest)
        found = dict(zip(names, parts, strict=True))
        if method == "triangle_splatting":
            found["sigma"] = buffers["sigma"][:, None]
    return {name: np.array(value, np.float64) for name, value in found.items()}


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_image_is_that_of_the_reference_and_derivatives_are_finite(view: View) -> None:
    scene = Scene(view)
    parameters = scene.parameters()
    drawn = scene.draw(parameters)
    assert worst(drawn.image.detach().numpy(), view.render(np.float64).image) < 1e-6
    drawn.image.square().mean().backward()
    for name, parameter in parameters.items():
        if name != "alpha_acc":  # opacity cut at 0.5 has no derivative
            assert np.isfinite(parameter.grad.numpy()).all(), name


@pytest.mark.parametrize("view", golden_views("diffsoup"), ids=names)
def test_expected_derivatives_are_finite(view: View) -> None:
    scene = Scene(view)
    parameters = scene.parameters()
    drawn = scene.draw(parameters, torch.from_numpy(np.array(view.image, np.float64)))
    (drawn.l1 + drawn.image.mean()).backward()
    assert all(np.isfinite(parameter.grad.numpy()).all() for parameter in parameters.values())
