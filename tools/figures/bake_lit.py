"""Create the image of surfaces under a lamp: `python -m tools.figures.bake_lit FOLDER`.

FOLDER is the folder of `python -m benchmarks.bake --geometry surface --folder FOLDER`. The image has a row
for each method: the pebble as stored (unlit), lit by a lamp, and the shape alone under this lamp.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

import msb
from benchmarks.bake import METHODS, SCENES, add_headings, read
from msb.base.origin import NO_ORIGIN
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.scenes import Camera

IMAGE = Path(__file__).parents[2] / "docs" / "images" / "bake_lit.png"
# Width and height of an image relative to the test view, and rows cut off at the top, which show nothing.
SCALE, CUT = 3, 60
TITLES = "unlit", "lit", "shape, lit"


def draw_row(asset: msb.Asset, camera: Camera) -> NDArray[np.float32]:
    """Return the unlit image, the lit image and the lit shape of a surface side by side (H, 3 W, 3)."""
    mesh = mesh_from_asset(asset)
    # A mesh without colours is drawn lit, with a lamp at the camera.
    shape = asset_from_mesh(Mesh(mesh.vertices, mesh.faces), origin=NO_ORIGIN)
    unlit, lit = (
        msb.render(part, camera, "standard", (1, 1, 1), supersample=2).image[CUT:] for part in (asset, shape)
    )
    return np.concatenate([unlit, unlit * lit, lit], axis=1)


def main() -> None:
    """Write the image of the surfaces in the folder."""
    folder = Path(sys.argv[1])
    rows = []
    for method in METHODS:
        asset = msb.open(folder / f"pebble-{method}-surface.triasset")
        scene = read(Path("data_stubs/models/pebble") / method, SCENES["pebble"], {})
        rows.append(draw_row(asset, scene.test[0].scaled(SCALE)))
    whole = Pillow.fromarray(np.uint8(np.concatenate(rows).clip(0, 1) * 255 + 0.5))
    add_headings(whole, TITLES).quantize(256, dither=Pillow.Dither.NONE).save(IMAGE, optimize=True)


if __name__ == "__main__":
    main()
