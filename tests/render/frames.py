"""The first frames of renderers, and comparisons of frames."""

from typing import Any

import numpy as np

from msb.asset import Asset
from msb.cl import Device
from msb.render import Frame
from msb.scenes import Camera

FIELDS = ("image", "alpha", "depth", "normal", "depth_median")


def frame_of(
    make: Any, asset: Asset, device: Device, camera: Camera, background: Any, **options: Any
) -> Frame:
    """Return the first frame of a renderer of class `make`, and close the renderer."""
    renderer = make(asset, device=device, **options)
    try:
        return renderer.render(camera, background)
    finally:
        renderer.close()


def assert_near(frame: Any, wanted: Any) -> None:
    """Assert that the same faces are visible; at most 0.2 % of the pixels may differ by more than 1e-4."""
    np.testing.assert_array_equal(frame.visible, wanted.visible)
    for name in FIELDS:
        values, right = getattr(frame, name), getattr(wanted, name)
        if right is None or values is None:
            continue
        scale = max(1.0, float(np.abs(right).max()))
        off = np.abs(values.astype(np.float64) - right).reshape(*right.shape[:2], -1).max(axis=-1) / scale
        assert (off > 1e-4).mean() <= 2e-3, name


def assert_same(first: Any, second: Any) -> None:
    """Assert that two frames are bit-identical."""
    for name in (*FIELDS, "face_id", "visible"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    for name, array in first.raw.items():
        np.testing.assert_array_equal(array, second.raw[name], err_msg=name)
