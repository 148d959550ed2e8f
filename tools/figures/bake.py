"""Create the image of a bake's page: `python -m tools.figures.bake`; needs Chromium and the extra trial.

`python -m tools.figures.bake FOLDER` draws the page of a folder that `msb bake -o FOLDER` wrote earlier.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageOps

ROOT = Path(__file__).parents[2]
STUBS = ROOT / "data_stubs"
IMAGE = ROOT / "docs" / "images" / "bake_folder.png"
SIZE = 1240, 700
"""Size of the browser's window in CSS pixels; from a width of 1200 on, the panel is open."""
WIDTH = 900
"""Width of the image in pixels; the window is empty on the right."""
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--hide-scrollbars",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--run-all-compositor-stages-before-draw",
    "--virtual-time-budget=100000",  # milliseconds for the page, which do not pass in real time
)


def bake_folder(folder: Path) -> None:
    """Bake the pebble as a closed surface, with levels of detail and a collision shape."""
    options = ["--for-solid", "--lods", "0.5,0.25,0.1", "--collision", "mesh:1000"]
    scene = STUBS / "scenes" / "nerf_synthetic" / "pebble"
    model = STUBS / "models" / "pebble" / "two_dts"
    command = [sys.executable, "-m", "msb", "bake", "-q", *options, "--scene", str(scene), str(model)]
    subprocess.run([*command, "-o", str(folder)], check=True)


def draw_page(folder: Path) -> Image.Image:
    """Return a screenshot of the page in `folder`."""
    browser = shutil.which("chromium") or shutil.which("google-chrome") or "chromium"
    page = f"{(folder / 'index.html').resolve().as_uri()}?camera=free"
    with tempfile.TemporaryDirectory() as temporary:
        shot = Path(temporary) / "shot.png"
        size = f"--window-size={SIZE[0]},{SIZE[1]}"
        subprocess.run([browser, *FLAGS, size, f"--screenshot={shot}", page], check=True)
        page_image = Image.open(shot).convert("RGB").crop((0, 0, WIDTH, SIZE[1]))
    framed = ImageOps.expand(page_image.crop((1, 1, WIDTH - 1, SIZE[1] - 1)), 1, "#c8c8c4")
    return framed.quantize(256, dither=Image.Dither.NONE)


def main() -> None:
    """Bake into a temporary folder, unless a folder is given, and write the image."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary) / "pebble"
        if len(sys.argv) < 2:
            bake_folder(folder)
        draw_page(folder).save(IMAGE, optimize=True)


if __name__ == "__main__":
    main()
