"""Create the images of baked pebbles under a lamp and from elsewhere.

    python -m tools.figures.bake_looks FOLDER

FOLDER is the folder of `python -m benchmarks.bake --folder FOLDER`. The first image has a row for each
method: the surface as stored (unlit), lit by a lamp at the camera, and the shape alone under this lamp. The
second image shows DiffSoup's pebble from above, from the side and from below: native rendering, fitted soup,
surface.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

import msb
from benchmarks.bake import METHODS, MODELS, SCENES, add_headings, read
from msb.base.origin import NO_ORIGIN
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from msb.scenes.around import make_turntable

IMAGES = Path(__file__).parents[2] / "docs" / "images"
# Width and height of an image under the lamp relative to the test view, and rows cut off at its empty top.
SCALE, CUT = 2, 40
# Heights of the cameras in degrees above the horizon, and the size of their images in pixels.
ELEVATIONS, SIZE = (35.0, 3.0, -50.0), (240, 180)
WHITE = (1.0, 1.0, 1.0)


def draw(asset: msb.Asset, camera: Camera) -> NDArray[np.float32]:
    """Return the standard-tier image (H, W, 3) on white with four samples per pixel."""
    return msb.render(asset, camera, "standard", WHITE, supersample=2).image


def draw_lit(asset: msb.Asset, camera: Camera) -> NDArray[np.float32]:
    """Return the unlit image, the lit image and the lit shape of a surface side by side (H, 3 W, 3)."""
    mesh = mesh_from_asset(asset)
    # A mesh without colours is drawn lit, with a lamp at the camera.
    shape = asset_from_mesh(Mesh(mesh.vertices, mesh.faces), origin=NO_ORIGIN)
    unlit, lit = (draw(part, camera)[CUT:] for part in (asset, shape))
    return np.concatenate([unlit, unlit * lit, lit], axis=1)


def save(rows: Sequence[NDArray[np.float32]], titles: Sequence[str], name: str) -> None:
    """Write the rows (H, W, 3) below the titles of their columns."""
    whole = Pillow.fromarray(np.uint8(np.concatenate(rows).clip(0, 1) * 255 + 0.5))
    add_headings(whole, titles).save(IMAGES / name, optimize=True)


def main() -> None:
    """Write the two images."""
    folder = Path(sys.argv[1])
    surfaces = {name: msb.open(folder / f"pebble-{name}-surface.triasset") for name in METHODS}
    camera = read(MODELS / "pebble" / METHODS[0], SCENES["pebble"], {}).test[0].scaled(SCALE)
    rows = [draw_lit(asset, camera) for asset in surfaces.values()]
    save(rows, ["unlit", "lit", "shape, lit"], "bake_lit.png")
    model, soup = (
        msb.open(MODELS / "pebble" / "diffsoup"),
        msb.open(folder / "pebble-diffsoup-fitted.triasset"),
    )
    cameras = [make_turntable(soup, 1, *SIZE, up="+z", elevation=height)[0] for height in ELEVATIONS]
    rows = [
        np.concatenate(
            [
                msb.render(model, camera, "dedicated", WHITE).image,
                draw(soup, camera),
                draw(surfaces["diffsoup"], camera),
            ],
            axis=1,
        )
        for camera in cameras
    ]
    save(rows, ["native rendering", "fitted", "surface"], "bake_elsewhere.png")


if __name__ == "__main__":
    main()
