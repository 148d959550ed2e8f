"""The official export formats of 2DTS, as trimesh writes them: GLB with vertex RGBA, PLY with face RGBA."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msb.adapters.official import rounded_bytes
from msb.asset import Asset
from msb.asset.activation import sigmoid
from msb.asset.look import baked_colors, stored_threshold, visible_faces
from msb.base.atomic import new_file
from msb.meshes.files import write_mesh
from msb.meshes.formats import Style
from msb.meshes.mesh import Mesh

SUFFIXES = (".glb", ".ply")


def write(asset: Asset, path: Path) -> None:
    """Write the triangles inside the scene box and above the STE threshold.

    A model may have no box and no threshold.

    Without back-face culling, each triangle is written twice, with both orientations.
    The formats follow GaodeRender/triangle-splatting at 54c80f7: export scripts.
    """
    buffers, settings = asset.buffers, asset.manifest.settings
    # Select faces by opacity and scene box.
    keep = visible_faces(asset, stored_threshold(asset))
    keep = np.ones(asset.manifest.face_count, bool) if keep is None else keep
    keep &= _in_box(asset)
    # Colours are evaluated at SH degree 0. If a threshold is set, every face that exceeds it gets the
    # opacity sigmoid(10).
    alpha = sigmoid(buffers["opacity"][keep])
    if settings["ste_threshold"].value is not None:
        alpha[:] = sigmoid(np.full(1, 10, np.float32))
    rgba = rounded_bytes(np.column_stack([baked_colors(buffers["f_dc"][keep]), alpha]))
    vertices = buffers["positions"].reshape(-1, 3, 3)[keep].reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
    twice = not settings["back_culling"].value
    all_faces = np.concatenate([faces, faces[:, ::-1]]) if twice else faces
    if path.suffix.lower() == ".glb":
        mesh = Mesh(vertices, all_faces, np.repeat(rgba, 3, axis=0), None)
    else:
        mesh = Mesh(vertices, all_faces, None, np.concatenate([rgba, rgba]) if twice else rgba)
    with new_file(path) as file:
        write_mesh(mesh, file, suffix=path.suffix, style=Style("srgb"))


def _in_box(asset: Asset) -> NDArray[np.bool_]:
    """Return which centroids are in the scene box or on its bounds. Without a box, return True for all
    centroids."""
    centroids = asset.buffers["positions"].reshape(-1, 3, 3).mean(axis=1)
    inside = np.ones(len(centroids), bool)
    for number, axis in enumerate("xyz"):
        low = asset.manifest.compositing.get(f"scene_bbox_min_{axis}")
        high = asset.manifest.compositing.get(f"scene_bbox_max_{axis}")
        if low is not None and high is not None:
            inside &= (centroids[:, number] >= low) & (centroids[:, number] <= high)
    return inside
