"""The pictures of the protocol: an asset drawn from held-out cameras, and its likeness to the photographs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msb import metrics
from msb.asset import Asset
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.metrics.images import psnr_of_mse
from msb.metrics.registry import mean_of
from msb.render.images import to_bytes
from msb.render.standard.renderer import StandardRenderer
from msb.score.capture import Capture, Image, TestView
from msb.score.pose import Pose


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawing of one held-out view, and its likeness to the photograph.

    Attributes
    ----------
    view : TestView
    image : (H, W, 3) uint8
        The drawing over the background.
    covered : (H, W) bool
        Pixels whose centre the asset covers.
    psnr, psnr_covered, psnr_mask, psnr_exposure, ssim, lpips : float or None
        In dB over all pixels; over covered pixels; over pixels of the mask; over all pixels, after the best
        gain and offset for each channel of the covered pixels. None if there is no such pixel, mask or
        network.
    """

    view: TestView
    image: NDArray[np.uint8]
    covered: NDArray[np.bool_]
    psnr: float | None
    psnr_covered: float | None
    psnr_mask: float | None
    psnr_exposure: float | None
    ssim: float | None
    lpips: float | None

    @property
    def drawn(self) -> Image:
        """The drawing (H, W, 3) with values in [0, 1]."""
        return self.image.astype(np.float32) / np.float32(255)

    @property
    def mask_share(self) -> float | None:
        """The share of the pixels of the mask that the asset covers."""
        mask = self.view.mask
        return None if mask is None or not mask.any() else float(self.covered[mask].mean())


def move_asset(asset: Asset, pose: Pose) -> Asset:
    """Return the standard-tier mesh of an asset in the frame of the capture, or `asset` if it is there."""
    if np.array_equal(pose.matrix, np.eye(4)):
        return asset
    mesh = mesh_from_asset(asset)
    vertices = mesh.vertices.astype(np.float64) @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]
    return asset_from_mesh(replace(mesh, vertices=vertices, up=None, frame=None))


def draw_pictures(
    asset: Asset,
    capture: Capture,
    measures: metrics.Measures,
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> list[Picture]:
    """Return a picture for each held-out view of an asset in the frame of the capture."""
    pictures, background = [], capture.protocol.background
    samples = capture.protocol.supersample
    with (
        contextlib.closing(StandardRenderer(asset, device=device, supersample=samples)) as fine,
        contextlib.closing(StandardRenderer(asset, device=device)) as coarse,
    ):
        for view in capture.test:
            camera = view.camera.in_units(asset.manifest.origin)
            image = to_bytes(fine.render_image(camera, background))
            covered = coarse.render(camera, background).alpha > 0
            pictures.append(_compare(view, image, covered, measures))
            step()
    return pictures


def _compare(
    view: TestView, image: NDArray[np.uint8], covered: NDArray[np.bool_], measures: metrics.Measures
) -> Picture:
    """Return the picture with its measured likeness."""
    values = measures(image, view.photograph)
    drawn = image.astype(np.float32) / np.float32(255)
    return Picture(
        view,
        image,
        covered,
        values["psnr"],
        psnr_within(drawn, view.photograph, covered),
        None if view.mask is None else psnr_within(drawn, view.photograph, view.mask),
        psnr_within(_fit_exposure(drawn, view.photograph, covered), view.photograph, np.ones_like(covered)),
        values["ssim"],
        values["lpips"],
    )


def psnr_within(image: Image, photograph: Image, where: NDArray[np.bool_]) -> float | None:
    """Return the PSNR in dB of the pixels `where` (H, W); None if there are none."""
    if not where.any():
        return None
    return psnr_of_mse(float(np.mean(np.square(image[where] - photograph[where], dtype=np.float64))))


def _fit_exposure(image: Image, photograph: Image, covered: NDArray[np.bool_]) -> Image:
    """Return the image with the gain and offset of each channel that fit the photograph best."""
    fitted = image.copy()
    for channel in range(3):
        x, y = image[covered, channel].astype(np.float64), photograph[covered, channel].astype(np.float64)
        if len(x) > 1 and x.std() > 0:
            gain = float(((x - x.mean()) * (y - y.mean())).mean() / x.var())
            fitted[covered, channel] = np.clip(gain * (x - x.mean()) + y.mean(), 0, 1)
    return fitted


def average_pictures(pictures: Sequence[Picture]) -> dict[str, float | None]:
    """Return the averages over views; views without a covered pixel do not count in `psnr_covered`."""
    looks: dict[str, float | None] = {}
    for name in ("psnr", "psnr_covered", "psnr_mask", "psnr_exposure", "ssim", "lpips"):
        values = [getattr(picture, name) for picture in pictures]
        if name in ("psnr_covered", "psnr_mask"):
            values = [value for value in values if value is not None]
        looks[name] = mean_of(values)
    return looks
