"""Front-to-back compositing as the three splatting methods share it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import Reals
from msb.reference.tiles import Integers, Tile

# Compositing of a sample stops here.
MIN_TRANSMITTANCE = 1e-4
# Faces of a tile that are evaluated at once: arrays of 64 x 256 samples stay in the cache.
_TOGETHER = 64


class Layers(NamedTuple):
    """What N faces look like, each at a sample of its own.

    Attributes
    ----------
    color : (N, 3)
    depth : (N,)
        Along the camera's z axis.
    normal : (N, 3)
        In camera space.
    """

    color: Reals
    depth: Reals
    normal: Reals


@dataclass(frozen=True)
class Rule:
    """Where the methods differ."""

    blends_crossing: bool
    """The face that takes transmittance T to the threshold is blended, and T <= 1e-4 stops the sample (2DTS);
    else it is refused when T would fall below 1e-4 (as in 3DGS)."""
    weight_first: bool
    """A colour's term is c (alpha T), not (c alpha) T."""


@dataclass(frozen=True)
class Composite:
    """Sums over the faces of every sample, without background; arrays of H x W samples.

    `depth_median` and `face_median` are those of the last blended face before which T > 0.5; 0 and -1 where
    there is none.
    """

    color: Reals
    transmittance: Reals
    depth: Reals
    normal: Reals
    depth_median: Reals
    face_median: NDArray[np.int32]

    def over(self, background: Reals) -> Reals:
        """Return colour + T background."""
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
    """Return the faces of every tile composited front to back.

    Parameters
    ----------
    tiles : iterable of Tile
        A sample that is in no tile stays empty.
    cover : callable
        Given K faces as (K, 1), and the columns and rows of P samples as (P,) reals, the alpha of every face
        at every sample, (K, P). Where it is below 1/255 the face is skipped.
    shade : callable
        Given N faces and the columns and rows of a sample each, all (N,), what the faces look like there. It
        is asked only where a face is blended.
    weights : (F,) float64, optional
        What each face contributes is added here: the sum over all samples of its alpha times T.
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
        for start in range(0, len(tile.faces), _TOGETHER):
            faces = tile.faces[start : start + _TOGETHER]
            alpha = cover(faces[:, None], x, y)
            # 1/255 is rounded as C rounds 1.0f / 255.0f.
            seen = alpha >= dtype(1) / dtype(255)
            somewhere = seen.any(axis=1)
            if not somewhere.any():
                continue
            faces, alpha = faces[somewhere], np.where(seen, alpha, 0)[somewhere]
            before, blended, goes_on = _attenuate(image.transmittance, pixels, alpha, rule)
            # Pairs of a sample and a face, front to back in every sample.
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
    """Let K faces of `alpha` (K, P) lower the transmittance T of P pixels.

    Returns T before every face and whether that is blended, both (K, P), and which pixels go on, (P,).
    """
    # T before the first face, between the faces, and after the last: products from front to back.
    chain = np.concatenate([transmittance[pixels][None], 1 - alpha])
    chain = np.multiply.accumulate(chain, axis=0)
    before, after = chain[:-1], chain[1:]
    # T never rises, so a sample that stops at a face stays stopped for all behind it.
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
    """Blend N faces into a pixel each, pixel by pixel and front to back; T is `before` in front of them."""
    weight = alpha * before
    if rule.weight_first:
        color = layers.color * weight[:, None]
    else:
        color = layers.color * alpha[:, None] * before[:, None]
    totals = (*image.color.T, image.depth, *image.normal.T)
    terms = (*color.T, layers.depth * weight, *(layers.normal * weight[:, None]).T)
    # add.at adds pair after pair, and is quick at one channel at a time.
    for total, term in zip(totals, terms, strict=True):
        np.add.at(total, pixels, term)
    # The last pair of each pixel before which T > 0.5.
    early = np.flatnonzero(before > 0.5)
    last = early[np.diff(pixels[early], append=-1) != 0]
    image.depth_median[pixels[last]] = layers.depth[last]
    image.face_median[pixels[last]] = faces[last]


def expected_depth(depth: Reals, alpha: Reals) -> Reals:
    """Return the sum of weight times depth divided by alpha, 0 where alpha is 0."""
    return np.where(alpha > 0, depth / np.where(alpha > 0, alpha, 1), 0).astype(depth.dtype)
