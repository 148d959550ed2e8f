"""The official DiffSoup evaluator's images and buffers, and its viewer's 8-bit ones."""

from __future__ import annotations

import numpy as np
import pytest

from msb.methods.diffsoup.reference import decode
from msb.reference import render_reference
from tests.reference.golden import View, exported, golden_views, names, psnr, worst

VIEWS = golden_views("diffsoup")


def kernel_rows(view: View, image: np.ndarray) -> np.ndarray:
    """Return an image in the kernel's row order."""
    return image[::-1] if view.stored["flip_rows"] else image


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
    """The key of the depth test is a float32 by definition, else near ties would fall otherwise."""
    frame, stored = view.render(np.float64), view.stored
    same = frame.raw["tri_id"] == stored["tri_id"]
    assert same[stored["stable"]].all()
    assert (~same).sum() <= 10
    assert worst(frame.image[view.stable], view.image[view.stable]) <= 1e-4


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_frame_is_in_image_order(view: View) -> None:
    frame, raw = view.frame, view.frame.raw
    np.testing.assert_array_equal(kernel_rows(view, frame.face_id), raw["tri_id"])
    np.testing.assert_array_equal(frame.alpha, frame.face_id >= 0)
    assert (frame.image[frame.alpha == 0] == np.float32(view.background)).all()
    seen = np.unique(frame.face_id[frame.face_id >= 0])
    np.testing.assert_array_equal(np.flatnonzero(frame.visible), seen)
    near, far, hit = view.settings["z_near"], view.settings["z_far"], raw["tri_id"] >= 0
    z = kernel_rows(view, frame.depth)[hit].astype(np.float64)
    assert worst((far + near - 2 * far * near / z) / (far - near), raw["depth"][hit]) <= 1e-4
    assert (frame.depth[frame.alpha == 0] == 0).all()


@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_the_web_export_looks_like_the_official_viewer(view: View) -> None:
    """Bytes stand for value / 255. The viewer rounds features to bytes once more before it decodes them.

    It also clips triangles that cross the camera plane, which the evaluator drops: the soup has such.
    """
    with np.load(view.folder / "viewer_views.npz") as file:
        arrays = {key: file[key] for key in file.files}
    number = view.name.partition("/")[2]
    shown = arrays[f"v{number}_viewer_image"] / np.float32(255)
    asset = exported(view.folder / "web_export" / view.folder.name)
    frame = render_reference(asset, view.camera, view.background, view.settings)
    if not view.name.startswith("soup"):
        assert psnr(kernel_rows(view, frame.image), shown) > 45
        assert psnr(kernel_rows(view, view.frame.image), shown) < 43
    if f"v{number}_gbuf_a" not in arrays:
        return
    first, second = arrays[f"v{number}_gbuf_a"], arrays[f"v{number}_gbuf_b"]
    target = np.concatenate([first, second[..., :3]], axis=-1)
    hit, drawn = frame.raw["tri_id"] >= 0, second[..., 3] > 0
    both = hit & drawn
    same = (np.rint(255 * frame.raw["features"]) == target).all(axis=-1)[both]
    if not view.name.startswith("soup"):
        assert (hit != drawn).sum() <= 2
        assert same.mean() > 0.999
    # From the viewer's own features on, its colours are ours up to the final rounding to a byte.
    features = (target[both] / np.float32(255)).astype(np.float32)[same]
    colors = decode(asset, features, frame.raw["sh"][both][same])
    assert worst(colors, shown[both][same]) <= 0.5 / 255 + 1e-4
