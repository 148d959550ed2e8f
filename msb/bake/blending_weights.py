"""This module measures the blending weight of each face and the number of pixels that show each face."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Floats, Ints
from msb.bake.images import ViewImages
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.registry import Tier
from msb.render import Renderer
from msb.render.shares import shares_by_view
from msb.scenes import Camera

# Colour of a face that no image shows: a neutral grey.
_UNSEEN_COLOR = 0.5


@dataclass(frozen=True, eq=False)
class BlendingWeights:
    """Sums over all pixels of all images, for F faces of a model.

    Attributes
    ----------
    weight : (F,) float64
        The blending weight of each face, in pixels (see `msb.render.shares`).
    color : (F, 3) float64
        The average image colour of the pixels that show the face, weighted by its blending weight. If the
        weight is 0, the colour is 0.5.
    pixels : int
        The number of pixels of all images.
    """

    weight: Floats
    color: Floats
    pixels: int


def measure_blending_weights(
    asset: Asset, images: ViewImages, device: str | Device | None = None
) -> BlendingWeights | None:
    """Return the blending weights of the faces of `asset` in the views of `images`.

    The weights are measured on the dedicated tier, or on the standard tier if the method has no native
    rendering. Return None if the renderer does not report which face a pixel shows. Raises the errors of
    `msb.Renderer`.
    """
    tier: Tier = "standard" if why_not(asset.manifest, "dedicated") else "dedicated"
    views = ((camera, images.image(number)) for number, camera in enumerate(images.cameras))
    # Sums (F, 4) over the pixels of each face: the blending weight times RGB, and the blending weight.
    sums = np.zeros((asset.manifest.face_count, 4))
    for shares in shares_by_view(asset, views, tier=tier, device=device):
        if shares is None:
            return None
        sums += shares
    weight = sums[:, 3]
    seen = weight > 0
    color = np.full((len(sums), 3), _UNSEEN_COLOR)
    color[seen] = sums[seen, :3] / weight[seen, None]
    pixels = sum(camera.width * camera.height for camera in images.cameras)
    return BlendingWeights(weight, color, pixels)


def count_pixels_by_view(
    mesh: Mesh, cameras: Iterable[Camera], device: str | Device | None = None
) -> Iterator[Ints]:
    """Yield for each camera the number of pixels (F,) that show each face of an opaque mesh."""
    # A mesh without colours would be drawn with lighting.
    black = replace(mesh, vertex_colors=np.zeros((len(mesh.vertices), 3), np.uint8))
    with Renderer(asset_from_mesh(black), "standard", device) as renderer:
        for camera in cameras:
            faces = renderer.render(camera).face_id
            assert faces is not None
            yield np.bincount(faces[faces >= 0], minlength=len(mesh.faces))
