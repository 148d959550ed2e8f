"""What the trainer draws is what the reference draws, to rounding in double, on every golden view."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.golden import View, golden_views, names, worst
from tests.training.conftest import Scene

METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")
VIEWS = [view for method in METHODS for view in golden_views(method)]


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
    import torch

    scene = Scene(view)
    parameters = scene.parameters()
    drawn = scene.draw(parameters, torch.from_numpy(np.array(view.image, np.float64)))
    (drawn.l1 + drawn.image.mean()).backward()
    assert all(np.isfinite(parameter.grad.numpy()).all() for parameter in parameters.values())
