"""Front-to-back compositing as the three splatting methods share it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from msb.reference.arithmetic import Reals
    from msb.reference.tiles import Integers, Tile

MIN_TRANSMITTANCE = 1e-4
"""Compositing of a sample stops here."""
_TOGETHER = 32
"""Faces of a tile that are evaluated at once: arrays of 32 x 256 samples stay in the cache."""


class Layers(NamedTuple):
    """What K faces are to P samples.

    Attributes
    ----------
    alpha : (K, P)
        Below 1/255 the face is skipped.
    color : (K, P or 1, 3)
    depth : (K, P or 1)
        Along the camera's z axis.
    normal : (K, P or 1, 3)
        In camera space.
    """

    alpha: Reals
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
    shade: Callable[[Integers, Reals, Reals], Layers],
    rule: Rule,
    width: int,
    height: int,
    dtype: type[Any],
) -> Composite:
    """Return the faces of every tile composited front to back.

    Parameters
    ----------
    tiles : iterable of Tile
        A sample that is in no tile stays empty.
    shade : callable
        Given K faces and the columns and rows of P samples as (P,) reals, what they are to each other.
    """
    image = Composite(
        color=np.zeros((height, width, 3), dtype),
        transmittance=np.ones((height, width), dtype),
        depth=np.zeros((height, width), dtype),
        normal=np.zeros((height, width, 3), dtype),
        depth_median=np.zeros((height, width), dtype),
        face_median=np.full((height, width), -1, np.int32),
    )
    for tile in tiles:
        samples = (tile.rows, tile.columns)
        x, y = tile.columns.astype(dtype), tile.rows.astype(dtype)
        done = np.zeros(len(x), bool)
        for start in range(0, len(tile.faces), _TOGETHER):
            faces = tile.faces[start : start + _TOGETHER]
            _blend(image, samples, faces, shade(faces, x, y), rule, done)
            if done.all():
                break
    return image


def _blend(
    image: Composite,
    samples: tuple[Integers, Integers],
    faces: Integers,
    layers: Layers,
    rule: Rule,
    done: NDArray[np.bool_],
) -> None:
    """Blend K faces into `image` at P samples; `done` (P,) marks those that have stopped."""
    dtype = layers.alpha.dtype.type
    # 1/255 is rounded as C rounds 1.0f / 255.0f.
    alpha = np.where(layers.alpha >= dtype(1) / dtype(255), layers.alpha, 0)
    threshold = dtype(MIN_TRANSMITTANCE)
    # T before the first face, between the faces, and after the last: products from front to back.
    chain = np.concatenate([image.transmittance[samples][None], 1 - alpha])
    chain = np.multiply.accumulate(chain, axis=0)
    before, after = chain[:-1], chain[1:]
    # T never rises, so a sample that stops at a face stays stopped for all behind it.
    blended = before > threshold if rule.blends_crossing else after >= threshold
    blended &= ~done
    alpha = np.where(blended, alpha, 0)
    weight = alpha * before
    # Outside a face its depth and colour may be extrapolated to infinity, and 0 times that is no 0.
    layer_color, layer_depth = (
        np.where(alpha[..., None] > 0, layers.color, 0),
        np.where(alpha > 0, layers.depth, 0),
    )
    if rule.weight_first:
        color = layer_color * weight[..., None]
    else:
        color = layer_color * alpha[..., None] * before[..., None]
    # Advanced indexing copies, so each sum is read, grown face by face (the order matters) and written back.
    for total, terms in (
        (image.color, color),
        (image.depth, layer_depth * weight),
        (image.normal, layers.normal * weight[..., None]),
    ):
        value = total[samples]
        for term in terms:
            value = value + term
        total[samples] = value
    _update_median(image, samples, faces, layers.depth, (alpha > 0) & (before > 0.5))
    image.transmittance[samples] = np.take_along_axis(chain, blended.sum(axis=0)[None], axis=0)[0]
    done |= after[-1] <= threshold if rule.blends_crossing else ~blended[-1]


def _update_median(
    image: Composite,
    samples: tuple[Integers, Integers],
    faces: Integers,
    depth: Reals,
    eligible: NDArray[np.bool_],
) -> None:
    """Take the last of K faces that is `eligible` (K, P) at each sample as its median so far."""
    found = eligible.any(axis=0)
    last = len(faces) - 1 - np.argmax(eligible[::-1], axis=0)
    depths = np.take_along_axis(np.broadcast_to(depth, eligible.shape), last[None], axis=0)[0]
    image.depth_median[samples] = np.where(found, depths, image.depth_median[samples])
    image.face_median[samples] = np.where(found, faces[last], image.face_median[samples])


def expected_depth(depth: Reals, alpha: Reals) -> Reals:
    """Return the sum of weight times depth divided by alpha, 0 where alpha is 0."""
    return np.where(alpha > 0, depth / np.where(alpha > 0, alpha, 1), 0).astype(depth.dtype)
