"""Contributions of faces to images agree with the NumPy reference, and are the transpose of rendering."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb.asset.sh import SH_C0
from msb.cl import Device
from msb.reference import render_reference
from msb.render.shares import shares_by_view
from msb.render.splat import pipeline as splatting
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera
from tests.reference.golden import View, exported, golden_views, names
from tests.reference.soups import front_camera
from tests.render.test_splatting import model, variants

GOLDEN = [
    pytest.param(view, id=names(view), marks=() if first else pytest.mark.slow)
    for method in ("two_dts", "triangle_splatting", "mesh_splatting")
    for first, view in [(k == 0, view) for k, view in enumerate(golden_views(method))]
    if view.name.endswith("/0")
]
BLACK = (0.0, 0.0, 0.0)


def picture_for(camera: Camera) -> np.ndarray:
    return np.random.default_rng(0).random((camera.height, camera.width, 3), np.float32)


@pytest.mark.parametrize("view", GOLDEN)
@pytest.mark.slow
def test_weights_match_the_reference(view: View, device: Device) -> None:
    pipeline = SplattingPipeline(
        exported(view.folder / "checkpoint"), device=device, settings=view.settings, outputs=()
    )
    weight = pipeline.shares(view.camera, picture_for(view.camera))[:, 3]
    np.testing.assert_array_equal(pipeline.shares(view.camera)[:, 0], weight)
    alpha = pipeline.render(view.camera, BLACK).alpha
    pipeline.close()
    assert view.frame.contribution is not None
    wanted = view.frame.contribution / pipeline._model.scale**2
    # The error of a sum of 256 float32 numbers is at most 1e-5. One in 1,000 faces may differ by more,
    # because rounding decides whether a sample is in the face, and whether its alpha reaches 1/255.
    assert (np.abs(weight - wanted) > 1e-5 * wanted + 1e-4).mean() <= 1e-3
    assert weight.sum() == pytest.approx(alpha.sum(dtype=np.float64), rel=1e-6)


@pytest.mark.slow
@variants
def test_summing_is_the_transpose_of_drawing(method: str, settings: dict[str, Any], device: Device) -> None:
    """Rendering faces of colours c gives A c. Summing a picture p gives A^T p. So p (A c) = c (A^T p)."""
    asset, camera = model(method, 3, degree=0), front_camera(61, 45)
    f_dc = np.random.default_rng(1).uniform(-1.5, 1.5, (asset.manifest.face_count, 3)).astype(np.float32)
    rows = f_dc.repeat(3, axis=0) if method == "mesh_splatting" else f_dc
    asset = replace(asset, buffers={**asset.buffers, "f_dc": rows})
    settings = {name: value for name, value in settings.items() if name != "sh_degree"}
    pipeline = SplattingPipeline(asset, device=device, settings=settings, outputs=())
    picture = picture_for(camera)
    frame, sums = pipeline.render(camera, BLACK), pipeline.shares(camera, picture)
    pipeline.close()
    drawn = np.einsum("yxp,yxc->pc", picture, frame.image, dtype=np.float64)
    np.testing.assert_allclose(sums[:, :3].T @ (0.5 + SH_C0 * f_dc), drawn, rtol=1e-5)
    assert sums[:, 3].sum() == pytest.approx(frame.alpha.sum(dtype=np.float64), rel=1e-5)


def test_bands_and_the_order_of_faces_do_not_change_results(
    cpu: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = front_camera(61, 90)
    pipeline = SplattingPipeline(model("mesh_splatting", 2), device=cpu, settings={"supersample": 3})
    first = pipeline.shares(camera, picture_for(camera))
    monkeypatch.setitem(splatting._BAND_BYTES, cpu.style, 1)
    pipeline._order_faces(at_frame=1)
    assert not pipeline._sort.by_rows
    np.testing.assert_array_equal(pipeline.shares(camera, picture_for(camera)), first)
    assert (first[:, 3] > 0).sum() > 30
    pipeline.close()


SETTINGS = {"mesh_splatting": {"supersample": 2}, "diffsoup": {}}


@pytest.mark.parametrize("method", SETTINGS)
def test_the_heaviest_faces_match_the_reference(method: str, cpu: Device) -> None:
    view = golden_views(method)[0]
    asset, settings = exported(view.folder / "checkpoint"), SETTINGS[method]
    cameras = [view.camera.scaled(size) for size in (0.5, 0.25)]
    views = ((camera, None) for camera in cameras)
    weights_drawn = sum(
        shares[:, 0] for shares in shares_by_view(asset, views, settings=settings, device=cpu)
    )
    frames = [render_reference(asset, camera, settings=settings) for camera in cameras]
    wanted = sum(frame.contribution for frame in frames) / settings.get("supersample", 1) ** 2
    assert (wanted > 0).sum() > 100
    # Rounding may decide whether alpha reaches 1/255 in a sample, so faces of nearly equal weight may change
    # places. Therefore compare the total weights of the faces that both select. The reference measures both
    # weights.
    for kept in (50, 100):
        chosen, best = (np.argsort(-weights, kind="stable")[:kept] for weights in (weights_drawn, wanted))
        assert wanted[chosen].sum() >= (1 - 1e-4) * wanted[best].sum()
    assert weights_drawn.sum() == pytest.approx(wanted.sum(), rel=1e-4)
