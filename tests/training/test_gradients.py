"""Gradients of the trainer's renderers equal finite differences of images, or of expected images.

Images are not continuous: they jump by up to 1/255 at the edges of windows and where weights below 1/255 are
dropped. A few parameters may lie at a jump, so only 90 % of the gradients must agree closely.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from data_stubs.training import (
    diffsoup,
    disc_splatting,
    gaussian_splatting,
    mesh_splatting,
    triangle_splatting,
    two_dts,
)
from data_stubs.training.composite import composite
from data_stubs.training.lattice import node_count
from msb.scenes import Camera

CAMERA = Camera.look_at((0.1, -0.2, -4), (0, 0, 0), up=(0, -1, 0), width=20, height=14, fov_y=0.7)
BACKGROUND = np.array([0.2, 0.5, 0.9])


def triangles(count: int, seed: int, size: float = 0.8) -> np.ndarray:
    """Return triangles (count, 3, 3) around the origin."""
    random = np.random.default_rng(seed)
    return random.uniform(-0.8, 0.8, (count, 1, 3)) + random.normal(0, size, (count, 3, 3))


def soup(names: tuple[str, str, str, str], count: int = 5, seed: int = 0) -> dict[str, np.ndarray]:
    """Return parameters with positions, opacity logits and SH of degree 2."""
    random = np.random.default_rng(seed + 100)
    parts = (
        triangles(count, seed),
        random.uniform(-1.0, 0.5, (count, 1)),
        random.normal(0.3, 0.6, (count, 1, 3)),
        random.normal(0, 0.2, (count, 8, 3)),
    )
    return dict(zip(names, parts, strict=True))


def tensors(values: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return new tensors that require gradients."""
    return {name: torch.from_numpy(value.copy()).requires_grad_() for name, value in values.items()}


STEP, COUNT = 1e-6, 16
"""Step of the finite differences, and number of tested values per parameter array. Half of the tested values
have the largest gradients; the others are spread evenly over the remaining ranks."""


def slope(
    function: Callable[[dict[str, Any]], Any], values: dict[str, np.ndarray], name: str, place: int
) -> float:
    """Return the central difference of `function` with respect to one value of a parameter."""
    ends = []
    for sign in (1, -1):
        changed = values | {name: values[name].copy()}
        changed[name].flat[place] += sign * STEP
        ends.append(float(function(tensors(changed)).detach()))
    return (ends[0] - ends[1]) / (2 * STEP)


def check(function: Callable[[dict[str, Any]], Any], values: dict[str, np.ndarray]) -> None:
    """Compare the gradients of `function` with central differences."""
    parameters = tensors(values)
    function(parameters).backward()
    for name, parameter in parameters.items():
        gradient = parameter.grad.numpy().reshape(-1)
        places = np.argsort(-np.abs(gradient))
        places = np.concatenate([places[: COUNT // 2], places[COUNT // 2 :: 1 + len(places) // (COUNT // 2)]])
        expected = np.array([slope(function, values, name, place) for place in places])
        scale = np.abs(expected).max()
        assert scale > 0, name
        error = np.abs(gradient[places] - expected) / scale
        assert (error <= 1e-4).mean() >= 0.9, (name, error.max())


def brightness(image: Any) -> Any:
    """Return a weighted sum of all pixels and channels, with different weights."""
    weights = torch.from_numpy(np.random.default_rng(9).uniform(0.5, 1.5, tuple(image.shape)))
    return (image * weights).sum()


@pytest.mark.parametrize(
    ("rasterizer", "gamma", "rescale"), [("2D", 1.0, False), ("3D", 1.0, False), ("3D", 3.0, True)]
)
def test_two_dts(rasterizer: str, gamma: float, rescale: bool) -> None:
    settings = {"rasterizer": rasterizer, "sh_degree": 2, "gamma": gamma, "gamma_rescale": rescale}
    settings |= {"back_culling": False, "ste_threshold": None, "render_up_scale": None}
    check(
        lambda p: brightness(two_dts.draw(p, CAMERA, BACKGROUND, settings).image),
        soup(("_vertex", "_opacity", "_f_dc", "_f_rest")),
    )


def test_triangle_splatting() -> None:
    settings = {"sh_degree": 2, "view_dir": "broadcast_z"}
    values = soup(("triangles_points", "opacity", "features_dc", "features_rest"))
    values["sigma"] = np.linspace(-0.3, 0.6, 5)[:, None]
    check(lambda p: brightness(triangle_splatting.draw(p, CAMERA, BACKGROUND, settings).image), values)


def test_mesh_splatting() -> None:
    indices = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 0], [1, 4, 2]])
    values = soup(("triangles_points", "vertex_weight", "features_dc", "features_rest"))
    values["triangles_points"] = values["triangles_points"][:, 0]
    settings = {"sh_degree": 1, "supersample": 2, "opacity_floor": 0.1, "sigma": 0.8}
    values["features_rest"] = values["features_rest"][:, :3]
    check(lambda p: brightness(mesh_splatting.draw(p, indices, CAMERA, BACKGROUND, settings).image), values)


@pytest.mark.parametrize(("module", "axes"), [(gaussian_splatting, 3), (disc_splatting, 2)])
def test_gaussian_splatting(module: Any, axes: int) -> None:
    random, count = np.random.default_rng(3), 6
    values = {
        "xyz": random.uniform(-0.8, 0.8, (count, 3)),
        "scale": np.log(random.uniform(0.1, 0.6, (count, axes))),
        "rotation": random.normal(size=(count, 4)),
        "opacity": random.uniform(-1.0, 2.0, (count, 1)),
        "f_dc": random.normal(0.3, 0.6, (count, 1, 3)),
        "f_rest": random.normal(0, 0.2, (count, 8, 3)),
    }
    settings = {"sh_degree": 2}
    check(lambda p: brightness(module.draw(p, CAMERA, BACKGROUND, settings).image), values)


def lattice_soup(level: int) -> dict[str, np.ndarray]:
    random, faces = np.random.default_rng(5), 4
    values = {
        "V": triangles(faces, 3).reshape(-1, 3),
        "feat_acc": random.uniform(0, 1, (faces, node_count(level), 7)),
        "alpha_acc": random.uniform(0.6, 0.9, (faces, node_count(level), 1)),
    }
    for layer, shape in {"mlp.0": (16, 16), "mlp.2": (16, 16), "mlp.4": (3, 16)}.items():
        values[f"{layer}.weight"] = random.normal(0, 0.4, shape)
        values[f"{layer}.bias"] = random.normal(0, 0.1, shape[0])
    return values


INDICES = np.arange(12).reshape(4, 3)
PLANES = {"layout": "colmap", "z_near": 0.5, "z_far": 100.0}


def test_diffsoup_with_thresholded_opacity_is_differentiable_except_by_opacity() -> None:
    values = lattice_soup(1)
    opacity = values.pop("alpha_acc")

    def drawn(parameters: dict[str, Any]) -> Any:
        whole = parameters | tensors({"alpha_acc": opacity})
        return brightness(diffsoup.draw(whole, INDICES, 1, CAMERA, BACKGROUND, PLANES).image)

    check(drawn, values)


def test_diffsoup_expected() -> None:
    target = torch.full((CAMERA.height, CAMERA.width, 3), 0.4, dtype=torch.float64)

    def drawn(parameters: dict[str, Any]) -> Any:
        expectation: Any = diffsoup.draw(parameters, INDICES, 1, CAMERA, BACKGROUND, PLANES, target)
        return brightness(expectation.image) + 100 * expectation.l1

    check(drawn, lattice_soup(1))


def test_expectation_equals_the_mean_over_random_thresholds() -> None:
    """The expected image and loss equal the means over images with random thresholds and sample positions."""
    parameters = tensors(lattice_soup(1))
    target = torch.full((CAMERA.height, CAMERA.width, 3), 0.4, dtype=torch.float64)
    random = np.random.default_rng(0)
    fragments: dict[str, Any] = {}

    def record_fragments(alpha: Any, color: Any, pairs: Any, **how: Any) -> Any:
        if len(color) == 4:
            fragments.update(alpha=alpha.detach().numpy(), color=color.detach().numpy(), pairs=pairs)
        return composite(alpha, color, pairs, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diffsoup, "composite", record_fragments)
        expectation: Any = diffsoup.draw(parameters, INDICES, 1, CAMERA, BACKGROUND, PLANES, target)
    alpha, color, ranks = fragments["alpha"], fragments["color"], fragments["pairs"].ranks
    draws, images, losses = 800, 0.0, 0.0
    for _ in range(draws):
        # A fragment exists with probability alpha; each pixel shows the nearest existing fragment.
        exists = (random.random(len(alpha)) < alpha)[ranks.pair]
        image = np.repeat(BACKGROUND[None], CAMERA.height * CAMERA.width, 0)
        free = np.ones(len(ranks.pixels), bool)
        for part, size in ranks.slices():
            takes = exists[part] & free[:size]
            image[ranks.pixels[:size][takes]] = color[:3, ranks.pair[part][takes]].T
            free[:size] &= ~takes
        images = images + image / draws
        losses = losses + np.abs(image - 0.4).mean() / draws
    expected = expectation.image.detach().numpy().reshape(-1, 3)
    assert np.abs(images - expected).max() < 0.08
    assert losses == pytest.approx(expectation.l1.item(), abs=4e-3)
