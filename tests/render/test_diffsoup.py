"""DiffSoup's kernels against images of the official evaluator and viewer, in both kernel styles."""

from typing import Any

import numpy as np
import pytest

from msb.cl import Device
from msb.methods.diffsoup.native import Pipeline as DiffSoupPipeline
from msb.render import Frame
from tests.cl.conftest import WITHOUT_ATOMICS, open_styled
from tests.golden.views import compare
from tests.reference.golden import View, exported, golden_views, names
from tests.render.frames import frame_of

VIEWS = golden_views("diffsoup")
TAME = [view for view in VIEWS if not view.name.startswith("soup")]
"""Views in which no triangle crosses the camera plane.

The viewer clips such triangles, and the evaluator drops them.
"""


def draw(device: Device, view: View, web: bool = False, **options: Any) -> Frame:
    asset = view.web if web else exported(view.folder / "checkpoint")
    options = {"settings": view.settings, **options}
    return frame_of(DiffSoupPipeline, asset, device, view.camera, view.background, **options)


@pytest.mark.slow
@pytest.mark.parametrize("view", VIEWS, ids=names)
def test_official_evaluation(device: Device, view: View) -> None:
    frame, stored = draw(device, view), view.stored
    same = frame.raw["tri_id"] == stored["tri_id"]
    assert same[stored["stable"]].all()
    assert (~same).mean() <= 0.005
    assert np.abs(frame.image - view.image)[view.stable].max() <= 1e-4
    quality, off = compare(frame.image, view.image, view.stable)
    assert quality > 128
    assert off == 0
    np.testing.assert_array_equal(frame.raw["mvp"], stored["mvp"])
    scale = np.abs(stored["mvp_inv"]).max()
    assert np.abs(frame.raw["mvp_inv"] - stored["mvp_inv"]).max() <= 2e-5 * scale  # 3e-7 where near is 0.5
    assert frame.raw["num_fragments"] == stored["num_fragments"]
    assert np.abs(frame.raw["bary01"] - stored["bary01"])[same].max() <= 2e-4
    assert np.abs(frame.raw["depth"] - stored["depth"])[same].max() <= 2e-5
    for name in {"features", "sh"} & stored.keys():
        assert np.abs(frame.raw[name] - stored[name])[same].max() <= 1e-5
    if "clip_vertices" in stored:
        indices = exported(view.folder / "checkpoint").buffers["indices"]
        np.testing.assert_allclose(
            frame.raw["clip_corners"], stored["clip_vertices"][indices], rtol=0, atol=5e-7
        )


@pytest.mark.slow
@pytest.mark.parametrize("view", [VIEWS[0], VIEWS[-1]], ids=names)
def test_outputs_select_the_parts_of_a_frame(device: Device, view: View) -> None:
    frame = draw(device, view)
    assert (frame.image.dtype, frame.depth.dtype, frame.face_id.dtype) == (np.float32, np.float32, np.int32)
    assert frame.normal is None
    assert set(frame.timings) == {"project", "clear", "raster", "decode", "read"}
    plain = draw(device, view, outputs=())
    assert set(plain.raw) == {"mvp", "mvp_inv", "tri_id"}
    np.testing.assert_array_equal(plain.image, frame.image)


@pytest.mark.slow
@pytest.mark.parametrize("view", TAME, ids=names)
def test_official_viewer(device: Device, view: View) -> None:
    """In the viewer features are bytes, both in textures and after interpolation."""
    frame = draw(device, view, web=True, viewer=True)
    viewer_image = view.viewer["viewer_image"]
    hit = view.kernel_rows(frame.alpha) > 0
    levels = np.abs(np.rint(255 * view.kernel_rows(frame.image)) - viewer_image.astype(int)).max(-1)
    assert (levels <= 1).mean() > 0.998  # pixels at edges, and noise in features
    assert (levels == 0).mean() > 0.99
    if "gbuf_a" in view.viewer:
        target = np.concatenate([view.viewer["gbuf_a"], view.viewer["gbuf_b"][..., :3]], axis=-1)
        drawn = view.viewer["gbuf_b"][..., 3] > 0
        assert (hit != drawn).sum() <= 2
        both = hit & drawn
        bytes_ = np.rint(255 * frame.raw["features"])
        assert (bytes_ == target).all(-1)[both].mean() > 0.999
    # Truncating the checkpoint's features gives the same image as the web export.
    again = draw(device, view, viewer=True)
    np.testing.assert_array_equal(again.image, frame.image)


@pytest.mark.slow
def test_a_gpu_without_64_bit_atomics_draws_with_its_work_groups() -> None:
    """On these devices the CPU style would also be correct, but much slower."""
    asset = exported(VIEWS[0].folder / "checkpoint")
    with open_styled(WITHOUT_ATOMICS) as device:
        assert DiffSoupPipeline(asset, device=device)._program.name.endswith("/diffsoup_gpu.cl")
