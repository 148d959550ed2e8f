"""Triangle Splatting+ against its golden views, and its differences to MeshSplatting."""

from dataclasses import replace

import numpy as np
import pytest

import msb
from msb.asset.manifest import StoredSetting
from msb.reference import ReferenceFrame, render_reference
from msb.scenes import Camera
from tests.golden.triangle_splatting_plus.make import FILE, scene
from tests.reference.golden import arrays_of, worst
from tests.reference.soups import front_camera, soup

SCENE = list(scene())


@pytest.mark.parametrize("number", range(len(SCENE)))
@pytest.mark.slow
def test_reference_and_kernels_give_the_golden_views(number: int) -> None:
    view, model = SCENE[number]
    assert model.manifest.method == "triangle_splatting_plus"
    stored = arrays_of(FILE, f"v{number}_")
    frame = render_reference(model, view.camera, view.background, view.settings)
    assert worst(frame.image, stored["image"]) <= 2e-6
    assert worst(frame.depth, stored["depth"]) <= 2e-5
    np.testing.assert_array_equal(frame.face_id, stored["face_id"])
    with msb.Renderer(model, tier="dedicated", settings=view.settings) as renderer:
        drawn = renderer.render(view.camera, view.background)
    assert worst(drawn.image, stored["image"]) <= 5e-6
    assert worst(frame.image, view.image) > 0.01  # an image by the rules of MeshSplatting is different


def render_black(method: str, camera: Camera) -> ReferenceFrame:
    """Return a slanted, opaque, black triangle over white."""
    corners = np.array([[[-2, -2, 4], [2, -2, 4], [0, 3, 8]]], np.float32)
    asset = soup(
        "mesh_splatting",
        corners,
        opacity=np.full(3, 20, np.float32),
        f_dc=np.full((3, 3), -10, np.float32),
    )
    settings = {**asset.manifest.settings, "opacity_floor": StoredSetting(0.9999, "default")}
    asset = replace(asset, manifest=replace(asset.manifest, method=method, settings=settings))
    return render_reference(asset, camera, (1.0, 1.0, 1.0), {"supersample": 1})


def test_alpha_is_at_most_099_and_a_face_has_one_depth() -> None:
    camera = front_camera(64, 48)
    plus, sibling = (render_black(name, camera) for name in ("triangle_splatting_plus", "mesh_splatting"))
    middle = (20, 32)
    np.testing.assert_allclose(plus.image[middle], 0.01, rtol=1e-3)
    np.testing.assert_allclose(sibling.image[middle], 0.001, rtol=1e-2)
    covered = plus.alpha > 0.5
    assert np.ptp(plus.depth[covered]) < 1e-4 < 0.5 < np.ptp(sibling.depth[covered])
