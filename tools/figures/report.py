"""Create images of the demo's report: `python -m tools.figures.report`; needs Chromium.

`python -m tools.figures.report out/demo/report` draws the pages of a report that `make demo` wrote earlier.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]
PROTOCOL = ROOT / "data_stubs" / "protocol.toml"
IMAGES = ROOT / "docs" / "images"
VERDICT = "verdict-mipnerf360-pebble-mesh_splatting.html"
COLORS = 256
"""Number of colours of the palette. The files have a third of the bytes, and text stays readable."""


def demo_report(folder: Path) -> Path:
    """Run the demo's benchmark below `folder` and return its report."""
    run, report = [[sys.executable, "-m", "msb", command, "-q"] for command in ("run", "report")]
    subprocess.run([*run, "-o", str(folder / "results"), str(PROTOCOL)], check=True)
    subprocess.run([*report, "-o", str(folder / "report"), str(folder / "results")], check=True)
    return folder / "report"


def screenshot(page: Path, width: int, height: int, name: str) -> None:
    """Write a screenshot of `page` in a browser window of this size in CSS pixels."""
    browser = shutil.which("chromium") or shutil.which("google-chrome") or "chromium"
    with tempfile.TemporaryDirectory() as folder:
        # A window has a minimum width, but a frame inside it can be narrower.
        frame = Path(folder) / "frame.html"
        style = f"border:0;width:{width}px;height:{height}px"
        frame.write_text(f'<body style="margin:0"><iframe src="{page.as_uri()}" style="{style}"></iframe>')
        shot = Path(folder) / "shot.png"
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        size = f"--window-size={max(width, 600)},{height}"
        subprocess.run([browser, *options, f"--screenshot={shot}", size, frame.as_uri()], check=True)
        picture = Image.open(shot).convert("RGB").crop((0, 0, width, height))
        picture.quantize(COLORS, dither=Image.Dither.NONE).save(IMAGES / name, optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        pages = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else demo_report(Path(temporary))
        # The heights end between two blocks of the pages.
        screenshot(pages / "index.html", 1280, 2140, "report.png")
        screenshot(pages / "index.html", 390, 1340, "report_phone.png")
        screenshot(pages / VERDICT, 1280, 1600, "report_verdict.png")
        # style.css of the site shows this image on narrow screens.
        screenshot(pages / VERDICT, 390, 730, "report_verdict_phone.png")
