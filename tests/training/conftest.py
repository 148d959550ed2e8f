"""What tests of the trainer share: the golden assets as its parameters, in double."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.reference.golden import exported

if TYPE_CHECKING:
    from tests.reference.golden import View


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test here: torch is installed by `make test-all` alone, and runs in a session of its own."""
    here = [item for item in items if item.path.is_relative_to(__file__.rpartition("/")[0])]
    for item in here:
        item.add_marker(pytest.mark.slow)
        item.add_marker(pytest.mark.torch)
        if find_spec("torch") is None:
            item.add_marker(pytest.mark.skip("extra train (torch) is not installed"))


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
        import torch

        return {name: torch.from_numpy(value).clone().requires_grad_() for name, value in self.values.items()}

    def draw(self, parameters: dict[str, Any], photograph: Any = None) -> Any:
        """Return what the trainer draws of `parameters`."""
        from data_stubs.training import diffsoup, mesh_splatting, triangle_splatting, two_dts

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
