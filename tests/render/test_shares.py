"""Faces in the order of what they add to several views: as the NumPy reference has it."""

import numpy as np
import pytest

from msb.cl import Device
from msb.reference import render_reference
from msb.render.shares import shares_by_view
from tests.reference.golden import exported, golden_views

SETTINGS = {"mesh_splatting": {"supersample": 2}, "diffsoup": {}}


@pytest.mark.parametrize("method", SETTINGS)
def test_the_heaviest_faces_are_those_of_the_reference(method: str, cpu: Device) -> None:
    view = golden_views(method)[0]
    asset, settings = exported(view.folder / "checkpoint"), SETTINGS[method]
    cameras = [view.camera.scaled(size) for size in (0.5, 0.25)]
    views = ((camera, None) for camera in cameras)
    found = sum(shares[:, 0] for shares in shares_by_view(asset, views, settings=settings, device=cpu))
    frames = [render_reference(asset, camera, settings=settings) for camera in cameras]
    wanted = sum(frame.contribution for frame in frames) / settings.get("supersample", 1) ** 2
    assert (wanted > 0).sum() > 100
    # A face differs where rounding decides whether its alpha in a sample reaches 1/255, so faces that weigh
    # nearly the same may change places: those kept weigh, by the reference, as much as its own choice.
    for kept in (50, 100):
        chosen, own = (np.argsort(-weights, kind="stable")[:kept] for weights in (found, wanted))
        assert wanted[chosen].sum() >= (1 - 1e-4) * wanted[own].sum()
    assert found.sum() == pytest.approx(wanted.sum(), rel=1e-4)
