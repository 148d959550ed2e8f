"""Records to aggregate: small, whole, and of known numbers."""

from __future__ import annotations

from typing import Any

from msb.bench.records import Cell, File, ImageQuality, Quality, Result, Setup, Timing
from msb.metrics import IMAGE_METRICS

IDENTITIES: tuple[dict[str, Any], ...] = tuple(
    {"name": name, "version": 1, "parameters": {}, "libraries": {"numpy": "2"}, "weights": None}
    for name in ("psnr", "ssim", "lpips_vgg")
)
SETUP = Setup(
    camera_convention="gs_fov", image_folder="images_4", gt_resized=False, background=(0.0, 0.0, 0.0)
)


def quality(
    psnr: float = 20.0, lpips: float | None = 0.2, *, names: tuple[str, ...] = ("a.png", "b.png")
) -> Quality:
    values: dict[str, Any] = dict.fromkeys(IMAGE_METRICS, 0.5) | {"psnr": psnr, "lpips": lpips}
    files = {"file": "images/x.png", "sha256": "0" * 64, "gt": "x.png"}
    images = tuple(ImageQuality(name=name, width=16, height=12, **files, **values) for name in names)
    return Quality(
        **values,
        lpips_reason=None,
        psnr_inf_count=0,
        images=images,
        metrics=IDENTITIES,
    )


def timing(fps: float = 100.0, *, frames: int = 100) -> Timing:
    span = 1000 / fps
    return Timing(
        frames=frames,
        seconds=frames / fps,
        fps=fps,
        p50_ms=span,
        p95_ms=span,
        mean_ms=span,
        busy_p50_ms=span,
        busy_p95_ms=span,
        queued_p50_ms=None,
        queued_p95_ms=None,
        round_fps=(fps, fps),
        stages_ms={},
        device_kind="cpu",
    )


def result(condition: str = "dedicated", *, scene: str = "garden", **parts: Any) -> Result:
    cell = Cell(dataset="mipnerf360", scene=scene, method="two_dts", condition=condition)
    given = {"status": "done", "seconds": 1.0, "setup": SETUP, "quality": quality(), **parts}
    return Result(cell=cell, **given)


def asset(digit: str = "a", size: int = 10) -> File:
    return File(path="x.triasset", bytes=size, sha256=digit * 64)
