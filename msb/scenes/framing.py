"""The part of an asset that fills generated views: everything except far outliers.

Far outliers are left out, because a few stray faces could move all cameras too far away from the mesh.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.activation import sigmoid
from msb.asset.build import measure_bounds
from msb.asset.look import normals_of
from msb.scenes.dense import find_dense

# A mesh must cover at least this share of the pixels of its views. If views cover fewer pixels, they are not
# used to judge the mesh. At 1 % coverage, the PSNR of the whole image is 20 dB above the PSNR of the covered
# pixels.
MIN_COVERAGE = 0.01
# Faces are isolated if all other faces are at most half as far from the middle. If isolated faces were in the
# image, all other faces would have only a quarter of their pixels.
_ISOLATED = 2.0
# Isolated faces are left out if their number and their area are at most these fractions of all faces.
_FEW_FACES, _LITTLE_AREA = 0.1, 0.01
# If the remaining faces would cover too few pixels, up to this fraction of isolated faces is left out,
# whatever their area is.
_STRAY_FACES = 0.01
# A dense part must contain at least this fraction of the faces or of the area of a mesh.
_DENSE = 0.9
# Factor in the estimate of pixel coverage: coverage = factor x area of the mesh / squared radius. On a
# turntable with 4:3 images, the measured factor was 0.042 for a sphere and 0.058 for a disc.
_COVERED = 0.05
# If the estimated pixel coverage is lower, only the dense part is framed. The dense part must cover at least
# twice this fraction of the pixels. For mesh parts that hide each other, the estimated coverage is up to four
# times too large.
_SPARSE = 4 * MIN_COVERAGE
# Largest number of faces used to compute the middle of an asset.
_SAMPLES = 200_000


@dataclass(frozen=True, eq=False)
class Framing:
    """A sphere that fills the images of generated views, and the faces inside the sphere.

    Attributes
    ----------
    center : (3,) floats
        The centre of the sphere, relative to the asset's origin.
    radius : float
        The radius of the sphere. For an asset without outliers, this is the radius of the bounding sphere.
    framed : (F,) mask, or None
        The faces inside the sphere. The value is None if the sphere contains all faces.
    left_out : str
        A description of the omitted parts. The text is "" if no part is omitted.
    box : ((3,) floats, (3,) floats), or None
        The lowest and highest coordinates of the framed part; only for Gaussians.
    """

    center: tuple[float, float, float]
    radius: float
    framed: NDArray[np.bool_] | None = None
    left_out: str = ""
    box: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None

    @property
    def note(self) -> str:
        """A text about the faces that generated views leave out.

        The text is the end of a sentence about generated views.

        The text is "" if no faces are left out.
        """
        return f"; far outliers are not framed: {self.left_out}" if self.left_out else ""


def find_framing(asset: Asset) -> Framing:
    """Return the sphere around an asset. Far outliers are left out if they are few and have little area.

    For Gaussians, everything outside the dense parts is left out.
    """
    if asset.manifest.primitive == "gaussian":
        return _frame_gaussians(asset)
    sphere = asset.manifest.bounding_sphere
    everything = Framing(sphere.center, sphere.radius)
    positions, faces = asset.buffers["positions"], asset.buffers["indices"]
    # Compute the distance (V,) of each vertex from the middle of the faces. Usually, no vertex is far away.
    # In this case, the search ends here.
    away = np.linalg.norm(positions - _find_middle(positions, faces), axis=1)
    if away.max() < _ISOLATED * np.median(away[_sample(faces)].max(axis=1)):
        return everything
    area = np.zeros(len(faces))
    for block, _, normals in normals_of(positions, faces):
        area[block] = np.linalg.norm(normals, axis=1) / 2
    solid = np.flatnonzero(np.isfinite(area) & (area > 0))
    if not len(solid):
        return everything
    # Compute the middle again, only from the n faces with a non-zero area. Compute the distances (n,) of the
    # nearest and farthest corner of each face.
    away = np.linalg.norm(positions - _find_middle(positions, faces[solid]), axis=1)
    corners = away[faces[solid]]
    near, far, area = corners.min(axis=1), corners.max(axis=1), area[solid]
    kept = _drop_isolated(near, far, area)
    kept[kept] = _find_dense(far[kept], area[kept])
    if kept.all() and away.max() < _ISOLATED * far.max():
        return everything
    framed = np.zeros(len(faces), bool)
    framed[solid[kept]] = True
    around = measure_bounds(positions[np.unique(faces[framed])])[1]
    text = "vertices that no face with an area uses"
    if count := int((~kept).sum()):
        radii = near[~kept].min() / max(around.radius, np.finfo(np.float64).tiny)
        more = "" if count == 1 else " or more"
        far_away = (
            f"{radii:,.0f} radii{more} away from the middle"
            if radii >= 2
            else "and extend far beyond all other faces"
        )
        text = f"{count:,} of {len(faces):,} faces, {far_away}"
    return Framing(around.center, around.radius, framed, text)


def _frame_gaussians(asset: Asset) -> Framing:
    """Return the sphere around the dense parts of Gaussians."""
    points = asset.buffers.get("gauss.mean")
    opacity = asset.buffers.get("opacity")
    if points is None or opacity is None or opacity.shape != (len(points),):
        sphere = asset.manifest.bounding_sphere
        return Framing(sphere.center, sphere.radius)
    framed = find_dense(points, sigmoid(opacity))
    box, sphere = measure_bounds(points[framed])
    count = int(np.count_nonzero(~framed))
    text = f"{count:,} of {len(points):,} Gaussians outside the dense parts" if count else ""
    return Framing(sphere.center, sphere.radius, framed, text, (box.min, box.max))


def _sample(faces: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return an evenly spread sample of about `_SAMPLES` faces at most."""
    return faces[:: max(1, len(faces) // _SAMPLES)]


def _find_middle(positions: NDArray[np.float32], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Return the median (3,) of the face centroids. Outliers do not move the median."""
    return np.asarray(np.median(positions[_sample(faces)].mean(axis=1, dtype=np.float64), axis=0))


def _drop_isolated(
    near: NDArray[np.float64], far: NDArray[np.float64], area: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return a mask (n,) of all faces except isolated faces. Isolated faces are left out only if they are few
    and have little area.

    `near` and `far` (n,) are the distances of each face's nearest and farthest corner.
    """
    order = np.argsort(near, kind="stable")
    # Sort the faces by distance. For each number k, compute the radius and the area of the first k faces.
    # Also compute the fraction of the remaining faces.
    radius = np.maximum.accumulate(far[order])
    inner = np.cumsum(area[order])
    start = np.arange(1, len(order))
    faces = 1 - start / len(order)
    isolated = near[order][1:] >= _ISOLATED * radius[:-1]
    is_nothing = (faces <= _FEW_FACES) & (inner[-1] - inner[:-1] <= _LITTLE_AREA * inner[-1])
    # The sphere around all faces has a radius of at least half of the largest distance.
    is_stray = (faces <= _STRAY_FACES) & (_COVERED * inner[:-1] < MIN_COVERAGE * (radius[-1] / 2) ** 2)
    kept = np.ones(len(order), bool)
    cuts = start[isolated & (is_nothing | is_stray)]
    if len(cuts):
        kept[order[cuts[0] :]] = False
    return kept


def _find_dense(far: NDArray[np.float64], area: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the faces in the dense part.

    If all faces together cover enough pixels, the mask contains all faces.

    If no dense part covers enough pixels, the mask contains all faces.
    """
    everything = np.ones(len(far), bool)
    # The sphere around all faces has a radius of at least half of the largest distance.
    if _COVERED * area.sum() >= _SPARSE * (far.max() / 2) ** 2:
        return everything
    # Sort the faces by distance. Among the spheres around the first k faces, find the spheres that contain
    # most faces. A sphere that contains most of the area and at least half of the faces is also accepted.
    order = np.argsort(far, kind="stable")
    radius, inner = far[order], np.cumsum(area[order])
    count = np.arange(1, len(order) + 1)
    is_most = (inner >= _DENSE * inner[-1]) & (2 * count >= len(order)) | (count >= _DENSE * len(order))
    is_covered = _COVERED * inner >= 2 * _SPARSE * radius**2
    good = np.flatnonzero(is_most & is_covered & (_ISOLATED * radius <= radius[-1]) & (radius > 0))
    if not len(good):
        return everything
    # Choose the sphere with the largest gap to the next face.
    best = good[np.argmax(radius[good + 1] / radius[good])]
    return np.asarray(far <= radius[best])
