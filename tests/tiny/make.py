"""Make the scenes and models in this folder: `python -m tests.tiny.make`.

The script always writes the same bytes, except for photographs: their compression depends on the version of
Pillow. Pixels of JPEG files then differ by at most one of 255 levels.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_stubs import captures, made_meshes, made_models
from data_stubs.photographs import averaged
from data_stubs.surface import Surface, pebble, walled
from msb.scenes import Camera
from tests.reference.standard import render_standard
from tests.tiny import MODELS, SCENES

SAMPLES = 4
"""Number of samples along each side of a pixel."""


def photograph(surface: Surface, camera: Camera) -> NDArray[np.float64]:
    """Return the image (H, W, 4) of a camera, rendered by the float64 reference of the standard tier."""
    fine = camera.resized(SAMPLES * camera.width, SAMPLES * camera.height)
    frame = render_standard(
        surface.vertices, surface.faces, surface.seen_from(camera.center), "vertex", replace(fine, name=None)
    )
    alpha = averaged(np.asarray(frame.alpha)[..., None], SAMPLES)
    color = averaged(np.asarray(frame.image), SAMPLES)  # over black, thus multiplied by alpha
    straight = np.divide(color, alpha, out=np.zeros_like(color), where=alpha > 0)
    return np.concatenate([straight, alpha], axis=2)


PEBBLE = captures.World(
    name="pebble",
    alone=pebble,
    inside=walled,
    photograph=photograph,
    views=16,
    around={"train": 12, "test": 4},
    sizes={
        "mipnerf360": (256, 192),
        "tanksandtemples": (112, 80),
        "nerf_synthetic": (144, 144),
        "dtu": (144, 108),
    },
    reduced={"images": 1, "images_2": 2, "images_4": 4},
    quality=92,
    levels=256,
    points=400,
    scanned=3000,
)


def write_models(folder: Path) -> None:
    """Write models of all methods for masked scenes, and of the trained methods for scenes with a wall."""
    made_models.write_models(folder / "pebble", pebble(), white=True, layout="synthetic")
    made_meshes.write_meshes(folder / "pebble", pebble(), white=True)
    surface = walled().turned(captures.Y_DOWN)
    made_models.write_models(folder / "walled", surface, white=False, layout="colmap")


if __name__ == "__main__":
    write_models(MODELS)
    captures.write_scenes(PEBBLE, SCENES)
