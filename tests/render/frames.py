"""Frames of a renderer that lives for one of them, and how they are compared."""

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
    """Return a frame by a renderer or pipeline of class `make`, which is closed again."""
    renderer = make(asset, device=device, **options)
    try:
        return renderer.render(camera, background)
    finally:
        renderer.close()


def assert_near(frame: Any, wanted: Any) -> None:
    """Assert that the same faces are visible, and that 0.2 % of the pixels at the most are off by 1e-4."""
    np.testing.assert_array_equal(frame.visible, wanted.visible)
    for name in FIELDS:
        found, right = getattr(frame, name), getattr(wanted, name)
        if right is None or found is None:
            continue
        scale = max(1.0, float(np.abs(right).max()))
        off = np.abs(found.astype(np.float64) - right).reshape(*right.shape[:2], -1).max(axis=-1) / scale
        assert (off > 1e-4).mean() <= 2e-3, name


def assert_same(one: Any, other: Any) -> None:
    """Assert that two frames are equal to the bit."""
    for name in (*FIELDS, "face_id", "visible"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name, array in one.raw.items():
        np.testing.assert_array_equal(array, other.raw[name], err_msg=name)
