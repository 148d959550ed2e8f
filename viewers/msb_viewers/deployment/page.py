"""`msb compare --html`: images of all tiers from all cameras on a single page, which works offline."""

import base64
import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb_viewers.deployment.compose import caption_lines, decibels
from msb_viewers.deployment.difference import ERROR_SCALE, TOP, TOPS
from msb_viewers.deployment.shots import LABELS, Shot
from msb_viewers.deployment.state import CompareState
from msb_viewers.deployment.views import View
from msb_viewers.template import build_page


def page(state: CompareState, rows: list[dict[str, Any]]) -> bytes:
    """Return the page as UTF-8; `rows` are results of `page_view`."""
    from msb.metrics.images import PSNR_CAP

    scene = state.comparison
    manifest = scene.asset.manifest
    meta = {
        "name": scene.name,
        "subtitle": f"{manifest.method}, {manifest.face_count:,} faces, {manifest.vertex_count:,} vertices",
        "settings": scene.settings_text(),
        "layout": state.layout,
        "pair": state.pair,
        "top": TOP,
        "tops": TOPS,
        "scale": ERROR_SCALE,
        "cap": PSNR_CAP,
        "tiers": [
            {"tier": tier, "label": LABELS[tier], "drawable": tier in scene.drawable} for tier in scene.tiers
        ],
        "views": rows,
    }
    return build_page("msb_viewers.deployment", meta)


def page_view(view: View, shots: Mapping[str, Shot]) -> dict[str, Any]:
    """Return the data of a view: images, captions and the PSNRs of all pairs of tiers."""
    psnrs: dict[str, float | str] = {}
    for a in sorted(shots):
        for b in sorted(shots):
            value = decibels(shots[a], shots[b]) if a < b else None
            if value is not None:
                psnrs[f"{a} {b}"] = "identical" if math.isinf(value) else value
    return {
        "name": view.name,
        "width": view.camera.width,
        "height": view.camera.height,
        "decibels": psnrs,
        "shots": {
            tier: {
                "image": None if shot.image is None else _data(shot.image),
                "why": shot.why,
                "lines": caption_lines(shot),
            }
            for tier, shot in shots.items()
        },
    }


def _data(image: NDArray[np.uint8]) -> str:
    """Return an image as a data URL of a PNG. A PNG is lossless, so the page can compute differences."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG", compress_level=6)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
