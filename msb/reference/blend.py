"""Front-to-back compositing, used by all splatting methods."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import Reals
from msb.reference.tiles import Integers, Tile

# Compositing of a sample stops at this transmittance.
MIN_TRANSMITTANCE = 1e-4
# Number of faces of a tile that are evaluated at once: arrays of 64 faces x 256 samples fit into the cache.
_TOGETHER = 64


class Layers(NamedTuple):
    """The appearance of N faces at one sample each.

    Attributes
    ----------
    color : (N, 3)
    depth : (N,)
        Depth along the camera's z axis.
    normal : (N, 3)
        Normal in camera space.
    """

    color: Reals
    depth: Reals
    normal: Reals


@dataclass(frozen=True)
class Rule:
    """The differences between the methods' compositing."""

    blends_crossing: bool
    """True if the face that lowers the transmittance T to the threshold is still blended (2DTS).

    If false, a face that would lower T below the threshold is not blended (3DGS).
    """
    weight_first: bool
    """True if a face of colour c adds c (alpha T) to the sum.

    If false, the face adds (c alpha) T, which rounds differently.
    """


@dataclass(frozen=True)
class Composite:
    """Sums over the faces at every sample, without background, as arrays of H x W samples.

    `depth_median` and `face_median` describe the last blended face that has a transmittance above 0.5 in
    front of it. In samples without faces, `depth_median` is 0 and `face_median` is -1.
    """

    color: Reals
    transmittance: Reals
    depth: Reals
    normal: Reals
    depth_median: Reals
    face_median: NDArray[np.int32]

    def over(self, background: Reals) -> Reals:
        """Return the composited colour plus T times the background."""
        return np.asarray(self.color + self.transmittance[..., None] * background)

    @property
    def alpha(self) -> Reals:
        """1 - T."""
        return np.asarray(1 - self.transmittance)


def composite(
    tiles: Iterable[Tile],
    cover: Callable[[Integers, Reals, Reals], Reals],
    shade: Callable[[Integers, Reals, Reals], Layers],
    rule: Rule,
    width: int,
    height: int,
    dtype: type[Any],
    weights: NDArray[np.float64] | None = None,
) -> Composite:
    """Composite the faces of every tile from front to back.

    Parameters
    ----------
    tiles : iterable of Tile
        Tiles of samples; samples outside all tiles stay empty.
    cover : callable
        A function with these arguments: K faces as (K, 1), and the columns and rows of P samples as (P,)
        reals. The function returns the alpha of every face at every sample, (K, P). Alpha values below 1/255
        are skipped.
    shade : callable
        A function with these arguments, all (N,): N faces, and the column and row of one sample for each
        face. The function returns the appearance of each face at its sample. The function is called only for
        blended faces.
    weights : (F,) float64, optional
        Receives the contribution of each face: the sum over all samples of alpha times T.
    """
    image = Composite(
        color=np.zeros((height * width, 3), dtype),
        transmittance=np.ones(height * width, dtype),
        depth=np.zeros(height * width, dtype),
        normal=np.zeros((height * width, 3), dtype),
        depth_median=np.zeros(height * width, dtype),
        face_median=np.full(height * width, -1, np.int32),
    )
    for tile in tiles:
        pixels = tile.rows * width + tile.columns
        x, y = tile.columns.astype(dtype), tile.rows.astype(dtype)
        # Blend K faces at a time into the P unfinished samples of the tile.
        for start in range(0, len(tile.faces), _TOGETHER):
            faces = tile.faces[start : start + _TOGETHER]
            alpha = cover(faces[:, None], x, y)
            # 1/255 is rounded like 1.0f / 255.0f in C.
            seen = alpha >= dtype(1) / dtype(255)
            somewhere = seen.any(axis=1)
            if not somewhere.any():
                continue
            faces, alpha = faces[somewhere], np.where(seen, alpha, 0)[somewhere]
            before, blended, goes_on = _attenuate(image.transmittance, pixels, alpha, rule)
            # List the N blended faces of all samples: first by sample, then from front to back.
            sample, face = np.nonzero(blended.T)
            layers = shade(faces[face], x[sample], y[sample])
            if weights is not None:
                weights[faces] += np.where(blended, alpha * before, 0).sum(axis=1, dtype=np.float64)
            _add(image, pixels[sample], faces[face], layers, alpha[face, sample], before[face, sample], rule)
            pixels, x, y = pixels[goes_on], x[goes_on], y[goes_on]
            if not len(pixels):
                break
    return Composite(**{name: a.reshape(height, width, *a.shape[1:]) for name, a in vars(image).items()})


def _attenuate(
    transmittance: Reals, pixels: Integers, alpha: Reals, rule: Rule
) -> tuple[Reals, NDArray[np.bool_], NDArray[np.bool_]]:
    """Lower the transmittance T of P pixels by the `alpha` (K, P) of K faces.

    Return three arrays: the transmittance T in front of each face (K, P), a mask of the blended faces (K, P),
    and a mask of the pixels that stay open (P,).
    """
    # Multiply from front to back. The rows are T in front of the first face, between faces, and behind the
    # last face.
    chain = np.concatenate([transmittance[pixels][None], 1 - alpha])
    chain = np.multiply.accumulate(chain, axis=0)
    before, after = chain[:-1], chain[1:]
    # T only falls along a ray, so all faces behind the stopping face are skipped.
    threshold = alpha.dtype.type(MIN_TRANSMITTANCE)
    goes_on = chain > threshold if rule.blends_crossing else chain >= threshold
    blended = goes_on[:-1] if rule.blends_crossing else goes_on[1:]
    transmittance[pixels] = np.where(blended, after, before[0]).min(axis=0)
    return before, blended & (alpha > 0), goes_on[-1]


def _add(
    image: Composite,
    pixels: Integers,
    faces: Integers,
    layers: Layers,
    alpha: Reals,
    before: Reals,
    rule: Rule,
) -> None:
    """Add N blended faces, each to one pixel. The pairs are sorted by pixel, then from front to back.

    `before` (N,) is the transmittance T in front of each face.
    """
    weight = alpha * before
    if rule.weight_first:
        color = layers.color * weight[:, None]
    else:
        color = layers.color * alpha[:, None] * before[:, None]
    totals = (*image.color.T, image.depth, *image.normal.T)
    terms = (*color.T, layers.depth * weight, *(layers.normal * weight[:, None]).T)
    # np.add.at adds the pairs one after another. Separate calls for each channel are faster.
    for total, term in zip(totals, terms, strict=True):
        np.add.at(total, pixels, term)
    # Find the last face of each pixel with T > 0.5 in front of the face.
    early = np.flatnonzero(before > 0.5)
    last = early[np.diff(pixels[early], append=-1) != 0]
    image.depth_median[pixels[last]] = layers.depth[last]
    image.face_median[pixels[last]] = faces[last]


def expected_depth(depth: Reals, alpha: Reals) -> Reals:
    """Return the expected depth: the sum of weight times depth, divided by alpha. Samples with alpha 0 have
    the depth 0."""
    return np.where(alpha > 0, depth / np.where(alpha > 0, alpha, 1), 0).astype(depth.dtype)
