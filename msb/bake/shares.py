"""What each face adds to the pictures that teach: in how many pixels, and what they show there."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Floats, Ints
from msb.bake.lessons import Lessons
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.registry import Tier
from msb.render import Renderer
from msb.render.shares import shares_by_view
from msb.scenes import Camera

_NO_COLOR = 0.5  # colour of a face that no image shows


@dataclass(frozen=True, eq=False)
class Shares:
    """Sums over all pixels of all pictures, for F faces.

    Attributes
    ----------
    weight : (F,) float64
        In pixels, as `msb.render.shares` has it.
    color : (F, 3) float64
        The mean of what the pictures show where the face is, weighted likewise; 0.5 where the weight is 0.
    pixels : int
        Of all pictures.
    """

    weight: Floats
    color: Floats
    pixels: int


def blending_shares(asset: Asset, lessons: Lessons, device: str | Device | None = None) -> Shares | None:
    """Return what each face of `asset` adds to the lessons, as its method draws it.

    The look is that of the dedicated tier, or of the standard one where the method has no look of its own.
    None if a package draws it and does not say which face a pixel shows. Raises what `msb.Renderer` raises.
    """
    tier: Tier = "standard" if why_not(asset.manifest, "dedicated") else "dedicated"
    views = ((camera, lessons.image(number)) for number, camera in enumerate(lessons.cameras))
    sums = np.zeros((asset.manifest.face_count, 4))
    for shares in shares_by_view(asset, views, tier=tier, device=device):
        if shares is None:
            return None
        sums += shares
    weight = sums[:, 3]
    seen = weight > 0
    color = np.full((len(sums), 3), _NO_COLOR)
    color[seen] = sums[seen, :3] / weight[seen, None]
    pixels = sum(camera.width * camera.height for camera in lessons.cameras)
    return Shares(weight, color, pixels)


def pixels_shown(mesh: Mesh, cameras: Iterable[Camera], device: str | Device | None = None) -> Iterator[Ints]:
    """Yield for each camera how many pixels (F,) of its picture show each face of an opaque mesh."""
    black = replace(mesh, vertex_colors=np.zeros((len(mesh.vertices), 3), np.uint8))  # or it would be lit
    with Renderer(asset_from_mesh(black), "standard", device) as renderer:
        for camera in cameras:
            faces = renderer.render(camera).face_id
            assert faces is not None
            yield np.bincount(faces[faces >= 0], minlength=len(mesh.faces))
