"""Converts the model's triangles to an opaque triangle soup, and prunes faces that cover too many pixels."""

from __future__ import annotations

import numpy as np

from msb.asset import Asset
from msb.asset.look import stored_threshold, visible_faces
from msb.asset.tiers import why_not
from msb.bake.blending_weights import BlendingWeights
from msb.bake.color_fit import count_pixels
from msb.bake.context import BestState
from msb.bake.soup import Soup
from msb.bake.soup_renderer import SoupRenderer
from msb.meshes.assets import mesh_from_asset, with_vertex_colors
from msb.meshes.charts import with_sampled_colors
from msb.meshes.mesh import Mesh

# Limits of a ratio: the blending weight of a face, divided by the number of pixels that the opaque face
# covers. The limits are tried in this order. A face whose ratio is below the limit is pruned, because the
# faces behind it contribute more to native renderings. The validation images decide which limit is best. The
# value 0.25 was best for a walled scene and for a garden. Limits above 0.4 open holes.
WEIGHT_RATIOS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
# A face is near a camera if its distance is below this share of the median distance of the visible faces.
_NEAR_SHARE = 0.25
# Covered pixels are measured in every second training view. Skipping half of the views saves a fifth of the
# time of a bake with kept triangles.
_VIEW_STEP = 2


def hide_stray_faces(soup: Soup, renderer: SoupRenderer, best: BestState) -> Soup:
    """Hide the stray faces of a soup. Return the best state.

    Faces that no training view shows are always hidden, because no image determines their place and colour.
    Faces that only a single view shows, and faces near a camera, often come from transparent haze that became
    opaque. Faces of this haze are hidden if hiding them does not increase the error in the validation images.
    """
    count = len(soup.selected)
    views, nearest = np.zeros(count, np.int64), np.full(count, np.inf)
    depths = []
    centers = soup.corners.mean(axis=1, dtype=np.float64)
    soup.upload(renderer)
    # Count the views (F,) that show each face, and find the smallest distance (F,) from a camera that sees
    # the face.
    for number, camera in enumerate(renderer.images.cameras):
        shown = renderer.sum_faces([number], gradients=False).max_pixels > 0
        distance = np.linalg.norm(centers[shown] - camera.center, axis=1)
        views += shown
        nearest[shown] = np.minimum(nearest[shown], distance)
        depths.append(distance)
    if views.any():
        soup.selected &= views > 0
    soup.refit_colors(renderer)
    best.restart(soup)
    near = _NEAR_SHARE * np.median(np.concatenate(depths)) if any(map(len, depths)) else 0.0
    for is_stray in (nearest < near, views == 1):
        trial = best.soup
        trial.selected &= ~is_stray
        if trial.selected_count:
            trial.refit_colors(renderer)
            best.evaluate(trial)
    return best.soup


def to_opaque_mesh(asset: Asset) -> Mesh:
    """Return the triangles of `asset` with vertex colours, or grey without static colours."""
    if why_not(asset.manifest, "standard") is not None:
        faces = asset.buffers["indices"].astype(np.int64)
        return Mesh(np.array(asset.buffers["positions"]), faces)
    return with_vertex_colors(with_sampled_colors(mesh_from_asset(asset)))


def prune_faces(
    soup: Soup, asset: Asset, renderer: SoupRenderer, best: BestState, weights: BlendingWeights | None
) -> None:
    """Prune faces of `soup` that cover far more pixels than they contribute to native renderings.

    The object `best` keeps the state with the smallest validation error. Without `weights` no face is pruned.
    A face has the average colour of the pixels that show it, until its colour is fitted.
    """
    if weights is not None:
        # Blending weights (F,) in pixels. The weights were measured in images of another size, so scale them
        # to the size of the drawn images.
        views = len(renderer.images)
        part = -(-views // _VIEW_STEP) / views
        visible = visible_faces(asset, stored_threshold(asset))
        weight, color = (
            values if visible is None else values[visible] for values in (weights.weight, weights.color)
        )
        weight = weight * (part * renderer.pixels / max(weights.pixels, 1))
        if soup.shared is None:
            soup.colors[weight > 0] = color[weight > 0, None].astype(np.float32)
    covered = count_pixels(soup.refit_colors(renderer, _VIEW_STEP))
    best.evaluate(soup)
    # Raise the limit of the ratio step by step. Fit the colours again after each pruning step, because
    # further faces become visible.
    for ratio in WEIGHT_RATIOS if weights is not None else ():
        soup.selected &= weight >= ratio * covered
        covered = count_pixels(soup.refit_colors(renderer, _VIEW_STEP))
        best.evaluate(soup)
