"""The certificate: a folder with the JSON documents, and one self-contained page with the pictures."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.own_folder import own_folder
from msb.base.version import __version__
from msb.metrics.images import PSNR_CAP
from msb.score.comparison import Comparison
from msb.score.measurement import Score
from msb.score.pictures import Picture
from msb.score.pose import spread_numbers

# Largest number of held-out views on the page, and largest width of a picture in pixels.
_VIEWS, _WIDTH = 8, 480
# Factor of differences in pictures: an error of 64 of 255 is white, or full red or green.
_GAIN = 4.0

_STYLE = """
:root { color-scheme: light dark; --ink: #1e2024; --faint: #5d6168; --page: #fff; --panel: #f5f5f2; --line:
  #d8d9dc;
  --yes: #00694a; --care: #8a5300; --no: #a33a00; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e5e8; --faint: #a2a6ad; --page: #16181c; --panel:
  #202329;
  --line: #3b3f47; --yes: #4fd0a5; --care: #f0b45a; --no: #ff9a66; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 0 16px 32px; max-width: 1180px; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 26px; line-height: 1.2; overflow-wrap: anywhere; margin: 24px 0 4px; }
h2 { font-size: 20px; border-top: 1px solid var(--line); padding-top: 12px; margin: 32px 0 8px;
  overflow-wrap: anywhere; }
p { max-width: 75ch; margin: 4px 0 12px; overflow-wrap: anywhere; }
.faint, figcaption { color: var(--faint); }
.verdict { border-left: 4px solid var(--care); background: var(--panel); padding: 8px 12px; }
.ok { border-color: var(--yes); } .bad { border-color: var(--no); }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); gap: 8px; margin: 12px 0; }
dl div { background: var(--panel); border: 1px solid var(--line); border-radius: 6px; padding: 6px 10px; }
dt { color: var(--faint); font-size: 13px; } dd { margin: 0; font-size: 19px; font-variant-numeric:
  tabular-nums; }
.views { display: grid; grid-template-columns: repeat(3, 1fr); gap: 6px; margin: 12px 0; }
figure { margin: 0; min-width: 0; } img { width: 100%; display: block; border-radius: 4px; }
figcaption { font-size: 12px; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: 14px; font-variant-numeric:
  tabular-nums; }
th, td { text-align: left; padding: 4px 10px; border-bottom: 1px solid var(--line); overflow-wrap:
  anywhere; }
th { font-weight: 600; white-space: nowrap; vertical-align: top; }
code { font-size: 12px; overflow-wrap: anywhere; }
"""


def write_certificate(
    folder: Path,
    scores: Sequence[Score],
    comparisons: Sequence[Comparison],
    documents: Sequence[dict[str, Any]],
    *,
    overwrite: bool = False,
) -> None:
    """Write index.html and score.json into `folder`. Comparisons are with the first of `scores`."""
    data = [{**document, "msb_version": __version__} for document in documents]
    with own_folder(folder, overwrite=overwrite) as place:
        page = "".join(_page(scores, comparisons, documents))
        (place / "index.html").write_text(page, encoding="utf-8", newline="\n")
        text = json.dumps(data[0] if len(data) == 1 else data, indent=1, allow_nan=False)
        (place / "score.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def _page(
    scores: Sequence[Score], comparisons: Sequence[Comparison], documents: Sequence[dict[str, Any]]
) -> list[str]:
    """Return the parts of the page."""
    first = scores[0]
    title = f"Certificate: {Path(first.path).name}"
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'\">",
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="faint">Against the photographs {html.escape(Path(first.capture).name)}, '
        f"{first.test_views} of them held out. Written by msb {__version__}.</p>",
    ]
    scored = [document for document in documents if "error" not in document]
    for number, (score, document) in enumerate(zip(scores, scored, strict=True)):
        parts += _describe_score(score, document, named=len(scores) > 1)
        if number:
            parts += _describe_comparison(scores[0], score, comparisons[number - 1])
    parts.append("</body></html>\n")
    return parts


def _describe_score(score: Score, document: dict[str, Any], *, named: bool) -> list[str]:
    """Return the section about one asset."""
    parts = [f"<h2>{html.escape(score.path)}</h2>"] if named else []
    level = {"unverified": "bad"}.get(score.status, "bad" if score.flags else score.structure.verdict)
    parts.append(f'<p class="verdict {level}"><strong>{html.escape(score.verdict)}</strong></p>')
    parts.append(f"<dl>{''.join(_list_numbers(score))}</dl>")
    if score.pictures:
        parts.append(
            "<h2>Pictures</h2><p>Photograph, asset, and their difference (white: 64 of 255 or more).</p>"
        )
        for picture in _choose(score.pictures):
            difference = np.abs(_photograph(picture) - picture.drawn).max(axis=2, keepdims=True)
            name = str(picture.view.camera.name)
            parts.append('<div class="views">')
            parts.append(_figure(_photograph(picture), name))
            parts.append(_figure(picture.drawn, f"PSNR {_number(picture.psnr, 1, ' dB')}"))
            parts.append(_figure(np.repeat(_GAIN * difference, 3, axis=2), "difference"))
            parts.append("</div>")
    parts.append('<h2>Details</h2><div class="scroll"><table>')
    parts += [
        f"<tr><th>{html.escape(key)}</th><td>{value}</td></tr>"
        for key, value in _list_details(score, document)
    ]
    parts.append("</table></div>")
    return parts


def _number(value: float | None, decimals: int, unit: str = "") -> str:
    return "--" if value is None else f"{min(value, PSNR_CAP) if unit == ' dB' else value:.{decimals}f}{unit}"


def _list_numbers(score: Score) -> list[str]:
    """Return the entries of the list of numbers."""
    looks = score.looks
    rows: list[tuple[str, str]] = []
    if looks is not None and score.covered_share is not None:
        rows = [
            ("PSNR", _number(looks["psnr"], 1, " dB")),
            ("PSNR, covered pixels", _number(looks["psnr_covered"], 1, " dB")),
            ("PSNR, exposure corrected", _number(looks["psnr_exposure"], 1, " dB")),
            ("SSIM", _number(looks["ssim"], 3)),
            ("LPIPS", _number(looks["lpips"], 3)),
            ("Covered", f"{100 * score.covered_share:.0f} %"),
        ]
        if looks["psnr_mask"] is not None:
            rows.insert(2, ("PSNR, masks", _number(looks["psnr_mask"], 1, " dB")))
        if score.steadiness is not None:
            rows.append(("Shimmer", f"{score.steadiness.shimmer:.1f} of 255"))
    rows += [("Faces", f"{score.structure.faces:,}"), ("File", f"{score.structure.bytes / 1e6:.1f} MB")]
    return [f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in rows]


def _list_details(score: Score, document: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table of details; values are HTML."""
    rows = [("Structure", html.escape(f"{score.structure.verdict.upper()}: {score.structure.sentence}"))]
    sizes = ", ".join(f"{width} x {height}" for width, height in score.structure.textures)
    rows.append(("Textures", sizes or "none"))
    if score.structure.texel_density is not None:
        rows.append(("Texel density", f"{score.structure.texel_density:.4g} texels per unit of the asset"))
    for tried in document["trial"] or ():
        text = f"{tried['outcome']}; {tried['why']}" if tried["why"] else tried["outcome"]
        rows.append((f"Trial: {tried['task']}", html.escape(text)))
    pose = score.pose
    if pose is not None:
        text = f"{pose.source}, scale {pose.scale:.6g}"
        if pose.residual is not None:
            text += f", {pose.photographs} photographs agree, residual {pose.residual:.2f} pixels"
        rows.append(("Pose", text))
        matrix = "; ".join(" ".join(f"{value:.6g}" for value in row) for row in pose.matrix)
        rows.append(("Matrix", f"<code>{matrix}</code>"))
    if score.evidence is not None:
        for key, value in score.evidence.to_dict().items():
            rows.append((key, "--" if value is None else f"{value:.4g}"))
    rows.append(
        ("Training views", "unknown: photographs that trained the asset cannot be told from its file")
    )
    rows += [(f"SHA-256, {key}", f"<code>{value}</code>") for key, value in score.hashes.items()]
    return rows


def _describe_comparison(first: Score, second: Score, comparison: Comparison) -> list[str]:
    """Return the section about the difference of two assets."""
    parts = [f"<h2>{html.escape(comparison.second)} compared with {html.escape(comparison.first)}</h2>"]
    parts.append('<div class="scroll"><table>')
    for name, entry in comparison.differences.items():
        ends = entry["interval"]
        around = "" if ends is None else f" (95 % interval {ends[0]:+.3f} to {ends[1]:+.3f})"
        parts.append(f"<tr><th>{name}</th><td>{entry['mean']:+.3f}{around}</td></tr>")
    parts.append("</table></div>")
    if first.pictures and second.pictures:
        parts.append("<p>Green: the second asset is nearer to the photograph. Red: it is farther away.</p>")
        parts.append('<div class="views">')
        for one, two in zip(_choose(first.pictures), _choose(second.pictures), strict=True):
            before, after = (
                np.abs(_photograph(picture) - picture.drawn).max(axis=2) for picture in (one, two)
            )
            gain = _GAIN * (before - after)
            shown = np.stack([np.maximum(-gain, 0), np.maximum(gain, 0), np.zeros_like(gain)], axis=2)
            parts.append(_figure(shown, str(one.view.camera.name)))
        parts.append("</div>")
    return parts


def _choose(pictures: Sequence[Picture]) -> list[Picture]:
    return [pictures[k] for k in spread_numbers(len(pictures), _VIEWS)]


def _photograph(picture: Picture) -> NDArray[np.float64]:
    return picture.view.photograph.astype(np.float64)


def _figure(image: NDArray[Any], caption: str) -> str:
    """Return a figure with an image (H, W, 3) in [0, 1] as JPEG, at most `_WIDTH` pixels wide."""
    from PIL import Image

    pixels = Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
    if pixels.width > _WIDTH:
        size = _WIDTH, max(1, round(pixels.height * _WIDTH / pixels.width))
        pixels = pixels.resize(size, Image.Resampling.BOX)
    stream = io.BytesIO()
    pixels.save(stream, "JPEG", quality=85)
    data = base64.b64encode(stream.getvalue()).decode()
    text = html.escape(caption)
    picture = f'<img alt="{text}" src="data:image/jpeg;base64,{data}">'
    return f"<figure>{picture}<figcaption>{text}</figcaption></figure>"
