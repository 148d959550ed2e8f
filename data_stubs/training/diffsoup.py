"""DiffSoup's image formation, differentiable; see `msb.methods.diffsoup.reference`.

In evaluation a pixel shows the nearest fragment with an opacity of at least 0.5. The image is differentiable
by the features, the decoder, and the position of the fragment in its triangle. In training, a fragment of
opacity a exists with probability a. (The official code draws a random threshold for each fragment.) Edges are
soft over one pixel, as if the sample were at a random position in the pixel. We render the *expected* image
over these random choices in closed form: it is alpha blending of the fragments by depth, with a as alpha. The
expected L1 loss has the same form; the colour of a fragment is replaced by its distance from the photograph.
The loss is minimal when every opacity is 0 or 1. The derivatives by opacity and by edge positions are exact
and without noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_stubs.training.composite import composite
from data_stubs.training.drawing import Drawn, as_float64, per_pair_dtype
from data_stubs.training.geometry import norm, transform
from data_stubs.training.lattice import Interpolate
from data_stubs.training.pair_functions import Affine, Highest, Quotient
from data_stubs.training.pairs import make_pairs
from msb.asset.sh import SH_C0, sh_basis
from msb.methods.diffsoup.reference import (
    BLEND_FEATURE,
    LAYERS,
    OPACITY_THRESHOLD,
    diffsoup_projection,
    ndc_centers,
    pixel_boxes,
    towards_camera,
)

if TYPE_CHECKING:
    from data_stubs.training.drawing import Parameters
    from data_stubs.training.pairs import Box, Pairs
    from msb.scenes import Camera

LEAST = 1 / 255
"""Fragments with a smaller weight are left out of the expected image."""


@dataclass(frozen=True, eq=False)
class Expected(Drawn):
    """The expected image, and the expected mean absolute difference from a photograph (a number)."""

    l1: torch.Tensor | None = None


def draw(
    parameters: Parameters,
    indices: NDArray[np.int64],
    level: int,
    camera: Camera,
    background: NDArray[np.float64],
    settings: Mapping[str, Any],
    photograph: torch.Tensor | None = None,
) -> Drawn:
    """Return the image of `parameters` (as in the official file) from `camera`.

    With a photograph (H, W, 3) the result is an `Expected`, with the L1 loss against it.
    """
    layout, up = settings["layout"], settings["layout"] != "colmap"
    mvp, inverse = diffsoup_projection(camera, layout, settings["z_near"], settings["z_far"], np.float64)
    soft = photograph is not None
    with np.errstate(all="ignore"):
        found = _fragments(parameters, indices, level, mvp, camera, soft)
    width, height = camera.width, camera.height
    pairs = found.pairs
    directions = towards_camera(inverse, *_centers(pairs, width, height))
    encoding = np.stack([np.full(len(pairs.x), SH_C0), *sh_basis(directions, 2)], axis=1)
    number = np.repeat(pairs.faces, pairs.counts)
    b0, b1 = found.barycentrics[0], found.barycentrics[1]
    features = Interpolate.apply(parameters["feat_acc"], b0, b1, number, level)
    color = decode(parameters, features, torch.from_numpy(encoding.astype(pairs.dtype)))
    behind = torch.as_tensor(background, dtype=color.dtype)
    if photograph is None:
        image = behind.expand(width * height, 3).index_put((torch.from_numpy(pairs.pixel).long(),), color)
        image = image.view(height, width, 3)
        ones = np.ones(len(pairs.x), pairs.dtype)
        return Drawn(image.flip(0) if up else image, pairs, ones, flipped=up)
    wanted = (photograph.flip(0) if up else photograph).reshape(-1, 3)
    away = (color - wanted[torch.from_numpy(pairs.pixel).long()]).abs().mean(1)
    alpha = found.opacity
    planes = torch.cat([color.T, away[None]])
    blended = composite(alpha, planes, pairs, blends_crossing=True, least=LEAST)
    through = blended.transmittance
    l1 = (blended.color[3] + through * (behind - wanted).abs().mean(1)).mean()
    image = (blended.color[:3] + through * behind[:, None]).T.reshape(height, width, 3)
    return Expected(image.flip(0) if up else image, pairs, blended.weight, flipped=up, l1=l1)


def decode(parameters: Parameters, features: torch.Tensor, encoding: torch.Tensor) -> torch.Tensor:
    """Return colours (n, 3) of features (n, 7) and encoded directions (n, 9)."""
    values = torch.cat([features, encoding], 1)
    for layer, (outputs, _) in LAYERS.items():
        values = values @ parameters[f"{layer}.weight"].T + parameters[f"{layer}.bias"]
        values = values.sigmoid() if outputs == 3 else values.relu()
    mix = features[:, BLEND_FEATURE, None]
    return (1 - mix) * features[:, :3] + mix * values


@dataclass(frozen=True, eq=False)
class _Fragments:
    """The pairs that are blended or shown, with their opacity (P,) and barycentric coordinates (3, P)."""

    pairs: Pairs
    opacity: torch.Tensor
    barycentrics: torch.Tensor


def _fragments(
    parameters: Parameters,
    indices: NDArray[np.int64],
    level: int,
    mvp: NDArray[np.float64],
    camera: Camera,
    soft: bool,
) -> _Fragments:
    width, height = camera.width, camera.height
    with torch.no_grad():
        clip = transform(mvp, torch.from_numpy(as_float64(parameters["V"])))[torch.from_numpy(indices)]
        rows = _rows(clip, width, height)
        planes = rows.numpy().copy()
        if soft:  # half a pixel wider
            planes[..., 2] += 0.5 * norm(rows[..., :2]).numpy()
    dropped, boxes = pixel_boxes(clip.numpy(), width, height)
    margin = int(soft)
    box: Box = (boxes[:, [0, 2]] - margin, boxes[:, [1, 3]] + margin)
    limit = np.array([width, height]) - 1
    box = np.clip(box[0], 0, limit), np.clip(box[1], 0, limit)
    every = make_pairs(np.flatnonzero(~dropped), planes, box, width, height, per_pair_dtype(parameters))
    with torch.no_grad():
        depth, opacity = _seen(parameters, every, clip.numpy(), rows, level, soft)
    key = (depth + 2).astype(np.float32)
    kept = (opacity >= (LEAST if soft else OPACITY_THRESHOLD)) & (depth > -1) & (depth <= 1)
    pairs = every.only(kept, key)
    if not soft:
        first = np.zeros(len(pairs.x), bool)
        ranks = pairs.ranks
        first[ranks.pair[: ranks.sizes[0] if ranks.sizes else 0]] = True
        pairs = pairs.only(first)
    else:
        pairs = _with_weight(pairs, opacity[kept])
    chosen = torch.from_numpy(indices[pairs.faces])
    corners = transform(mvp, parameters["V"].double()[chosen])
    rows = _rows(corners, width, height)
    barycentrics = Quotient.apply(Affine.apply(rows, pairs), 0.0)
    opacity = _opacity(parameters, pairs, rows, barycentrics, level) if soft else torch.zeros(0)
    if soft:
        barycentrics = _inside(barycentrics)
    return _Fragments(pairs, opacity, barycentrics)


def _rows(clip: torch.Tensor, width: int, height: int) -> torch.Tensor:
    """Return rows (a, b, c): numerators a x + b y + c of barycentric coordinates, for corners (G, 3, 4).

    The sum of the numerators is positive inside. x and y are the column and row of a sample, not NDC.
    """
    x, y, _, w = clip.unbind(-1)
    screen = torch.stack([x, y, w], -1)
    first, second, third = screen.unbind(1)
    normals = torch.stack(
        [torch.cross(a, b, dim=1) for a, b in ((second, third), (third, first), (first, second))], 1
    )
    normals = normals * torch.sign((first * normals[:, 0]).sum(1).detach())[:, None, None]
    a, b, c = normals.unbind(-1)
    constant = a * (1 / width - 1) + b * (1 / height - 1) + c
    return torch.stack([a * (2 / width), b * (2 / height), constant], -1)


def _opacity(
    parameters: Parameters, pairs: Pairs, rows: torch.Tensor, barycentrics: torch.Tensor, level: int
) -> torch.Tensor:
    """Return the probability that a fragment exists: its opacity, which decreases to 0 at edges."""
    inside = _inside(barycentrics)
    number = np.repeat(pairs.faces, pairs.counts)
    table = parameters["alpha_acc"]
    found = Interpolate.apply(table, inside[0], inside[1], number, level)[:, 0]
    distances = Affine.apply(rows / norm(rows[..., :2])[..., None], pairs)
    return found * (0.5 - Highest.apply(-distances)).clamp(0, 1)


def _inside(barycentrics: torch.Tensor) -> torch.Tensor:
    """Return barycentric coordinates; points up to half a pixel outside are moved to the edge."""
    positive = barycentrics.clamp(min=0)
    return positive / positive.sum(0)


def _seen(
    parameters: Parameters,
    pairs: Pairs,
    clip: NDArray[np.float64],
    rows: torch.Tensor,
    level: int,
    soft: bool,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the NDC depth and the opacity of every pair, (P,); 0 outside of a triangle."""
    rows = rows[torch.from_numpy(pairs.faces)]
    barycentrics = Quotient.apply(Affine.apply(rows, pairs), 0.0)
    if soft:
        opacity = _opacity(parameters, pairs, rows, barycentrics, level).numpy()
        b0, b1, b2 = _inside(barycentrics).numpy()
    else:
        b0, b1, b2 = barycentrics.numpy()
        inside = (b0 >= 0) & (b1 >= 0) & (b0 + b1 <= 1)
        number = np.repeat(pairs.faces, pairs.counts)
        safe = torch.from_numpy(np.where(inside, b0, 0)), torch.from_numpy(np.where(inside, b1, 0))
        opacity = Interpolate.apply(parameters["alpha_acc"], *safe, number, level)[:, 0].numpy() * inside
    corners = clip[pairs.faces]
    z, w = (sum(pairs.spread(corners[:, k, axis]) * b for k, b in enumerate((b0, b1, b2))) for axis in (2, 3))
    return np.asarray(z / w), opacity


def _with_weight(pairs: Pairs, opacity: NDArray[Any]) -> Pairs:
    """Return the pairs whose weight in the blending is not negligible."""
    nothing = torch.zeros((1, len(opacity)), dtype=torch.from_numpy(opacity).dtype)
    with torch.no_grad():
        weight = composite(
            torch.from_numpy(opacity), nothing, pairs, blends_crossing=True, least=LEAST
        ).weight
    return pairs.only(weight >= LEAST, pairs.key)


def _centers(pairs: Pairs, width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    column, row = pairs.pixel % width, pairs.pixel // width
    return ndc_centers(width, np.float64)[column], ndc_centers(height, np.float64)[row]
