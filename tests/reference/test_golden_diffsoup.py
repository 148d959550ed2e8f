"""DiffSoup's reference against the official evaluator's images and buffers, and the viewer's images."""

import numpy as np
import pytest

from msb.methods.diffsoup.reference import decode
from msb.reference import render_reference
from tests.reference.golden import View, golden_views, names, psnr, worst

VIEWS = golden_views("diffsoup")


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float32_repeats_the_official_kernels(view: View) -> None:
    frame, stored = view.frame, view.stored
    same = frame.raw["tri_id"] == stored["tri_id"]
    assert same[stored["stable"]].all()
    assert (~same).mean() <= 0.005
    assert worst(frame.image[view.stable], view.image[view.stable]) <= 1e-4
    assert psnr(frame.image[view.stable], view.image[view.stable]) >= 128
    assert frame.raw["num_fragments"] == stored["num_fragments"]
    assert worst(frame.raw["bary01"][same], stored["bary01"][same]) <= 2e-4
    assert worst(frame.raw["depth"][same], stored["depth"][same]) <= 2e-5
    for name in ("features", "sh"):
        if name in stored:
            assert worst(frame.raw[name][same], stored[name][same]) <= 1e-5
    if "clip_vertices" in stored:
        assert worst(frame.raw["clip_vertices"], stored["clip_vertices"]) <= 5e-7


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_float64_sees_the_same_faces(view: View) -> None:
    """The depth key is float32 by definition, so nearly equal depths count as equal even in float64."""
    frame, stored = view.render(np.float64), view.stored
    same = frame.raw["tri_id"] == stored["tri_id"]
    assert same[stored["stable"]].all()
    assert (~same).sum() <= 10
    assert worst(frame.image[view.stable], view.image[view.stable]) <= 1e-4


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_frame_is_in_image_order(view: View) -> None:
    frame, raw = view.frame, view.frame.raw
    np.testing.assert_array_equal(view.kernel_rows(frame.face_id), raw["tri_id"])
    np.testing.assert_array_equal(frame.alpha, frame.face_id >= 0)
    assert (frame.image[frame.alpha == 0] == np.float32(view.background)).all()
    seen = np.unique(frame.face_id[frame.face_id >= 0])
    np.testing.assert_array_equal(np.flatnonzero(frame.visible), seen)
    near, far, hit = view.settings["z_near"], view.settings["z_far"], raw["tri_id"] >= 0
    z = view.kernel_rows(frame.depth)[hit].astype(np.float64)
    assert worst((far + near - 2 * far * near / z) / (far - near), raw["depth"][hit]) <= 1e-4
    assert (frame.depth[frame.alpha == 0] == 0).all()


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_the_web_export_matches_the_official_viewer(view: View) -> None:
    """A byte b stands for the value b / 255. The viewer rounds features to bytes once more before decoding.

    The viewer also clips triangles across the camera plane, which the evaluator drops. The soup contains such
    triangles.
    """
    viewer_image = view.viewer["viewer_image"] / np.float32(255)
    frame = render_reference(view.web, view.camera, view.background, view.settings)
    if not view.name.startswith("soup"):
        assert psnr(view.kernel_rows(frame.image), viewer_image) > 45
        assert psnr(view.kernel_rows(view.frame.image), viewer_image) < 43
    if "gbuf_a" not in view.viewer:
        return
    first, second = view.viewer["gbuf_a"], view.viewer["gbuf_b"]
    target = np.concatenate([first, second[..., :3]], axis=-1)
    hit, drawn = frame.raw["tri_id"] >= 0, second[..., 3] > 0
    both = hit & drawn
    same = (np.rint(255 * frame.raw["features"]) == target).all(axis=-1)[both]
    if not view.name.startswith("soup"):
        assert (hit != drawn).sum() <= 2
        assert same.mean() > 0.999
    # Decoding the viewer's features gives the viewer's colours, except for their final rounding to bytes.
    features = (target[both] / np.float32(255)).astype(np.float32)[same]
    colors = decode(view.web, features, frame.raw["sh"][both][same])
    assert worst(colors, viewer_image[both][same]) <= 0.5 / 255 + 1e-4
