"""SIFT features of photographs and drawings, and their matches.

D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60 (2004). Descriptors are
compared as RootSIFT: R. Arandjelovic and A. Zisserman, "Three things everyone should know to improve object
retrieval" (CVPR 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Largest ratio of the similarities' angles of the best and the second best match (Lowe, section 7.1).
_RATIO = 0.85
# Least product of RootSIFT descriptors of two features that show the same point.
_SIMILAR = 0.85
# Contrast threshold of the detector: half of OpenCV's default, because renderings and blurred photographs
# have little contrast.
_CONTRAST = 0.02


@dataclass(frozen=True, eq=False)
class Features:
    """Features of an image: `pixels` (N, 2), x and y from its corner, and unit `descriptors` (N, 128)."""

    pixels: NDArray[np.float64]
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, rows: NDArray[np.int_] | NDArray[np.bool_] | slice) -> Features:
        """Return some of the features."""
        return Features(self.pixels[rows], self.descriptors[rows])

    def mirrored(self) -> Features:
        """Return the features of the mirror image, with the pixels of this image.

        OpenCV's descriptors have 4 rows and 4 columns along the feature's direction, and 8 directions of the
        gradient. A reflection along that direction reverses the rows, and the sense of rotation.
        """
        bins = self.descriptors.reshape(-1, 4, 4, 8)[:, ::-1][..., -np.arange(8) % 8]
        return Features(self.pixels, np.ascontiguousarray(bins.reshape(-1, 128)))


def detect_features(
    image: NDArray[np.floating], most: int, mask: NDArray[np.bool_] | None = None
) -> Features:
    """Return the strongest features, the strongest first, of an image (H, W, 3) with values in [0, 1].

    Only features at pixels of `mask` (H, W) are returned.
    """
    import cv2

    grey = np.asarray(np.clip(image, 0, 1) @ (0.299, 0.587, 0.114) * 255 + 0.5, np.uint8)
    sift = cv2.SIFT.create(nfeatures=most, contrastThreshold=_CONTRAST)
    where = None if mask is None else mask.astype(np.uint8) * 255
    points, descriptors = sift.detectAndCompute(grey, where)
    if not points:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    order = np.argsort([-point.response for point in points], kind="stable")[:most]
    # The centre of OpenCV's first pixel is (0, 0); ours is (0.5, 0.5).
    pixels = np.array([points[k].pt for k in order]) + 0.5
    roots = np.sqrt(descriptors[order] / np.maximum(descriptors[order].sum(axis=1, keepdims=True), 1e-9))
    return Features(pixels, np.asarray(roots, np.float32))


def match_features(first: Features, second: Features) -> NDArray[np.int_]:
    """Return the pairs (N, 2) of features that are each other's best match, and better than the next."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.int_)
    similar = first.descriptors @ second.descriptors.T
    best, back = similar.argmax(axis=1), similar.argmax(axis=0)
    rows = np.flatnonzero(back[best] == np.arange(len(first)))
    # The distance of unit vectors a and b is sqrt(2 - 2 a b). The second best is found without the best.
    value = similar[rows, best[rows]]
    others = similar[rows]
    others[np.arange(len(rows)), best[rows]] = -1
    clear = 1 - value < _RATIO**2 * (1 - others.max(axis=1))
    return np.stack([rows[clear], best[rows[clear]]], axis=1)


def match_nearby(first: Features, second: Features, radius: float) -> NDArray[np.int_]:
    """Return the pairs (N, 2) of mutually best, similar features that are at most `radius` pixels apart."""
    from scipy.spatial import cKDTree

    if not len(first) or not len(second):
        return np.zeros((0, 2), np.int_)
    near = cKDTree(first.pixels).sparse_distance_matrix(
        cKDTree(second.pixels), radius, output_type="coo_matrix"
    )
    rows, columns = near.row, near.col
    similar = np.einsum("nk,nk->n", first.descriptors[rows], second.descriptors[columns])
    # The best partner of each feature, by similarity: the last entry in ascending order wins.
    order = np.argsort(similar, kind="stable")
    order = order[similar[order] > _SIMILAR]
    best, back = np.full(len(first), -1), np.full(len(second), -1)
    best[rows[order]], back[columns[order]] = columns[order], rows[order]
    mutual = np.flatnonzero((best >= 0) & (back[best] == np.arange(len(first))))
    return np.stack([mutual, best[mutual]], axis=1)
