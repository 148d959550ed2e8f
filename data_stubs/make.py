"""Make the tiny assets of this folder: `python -m data_stubs.make`. Same script, same bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_stubs.splat_like import splat_like
from msb.asset import Asset, Description, build_asset, save
from msb.asset.manifest import CoordinateFrame, StoredSetting
from msb.meshes.assets import SH_C0
from msb.methods import METHODS

HERE = Path(__file__).parent
SIZE = 36
"""Lattice of the demo mesh: about 35 thousand faces, a hundredth of a real export."""


def splat_like_asset(n: int = SIZE) -> Asset:
    """Return a MeshSplatting-like asset: its structure from the generator, a colour for each direction.

    Vertex opacities are logits as a trained model has them: mostly opaque, some not.
    """
    vertices, faces = splat_like(n)
    direction = vertices - np.float32(0.5)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    bands = 0.12 * np.sin(12 * np.pi * vertices[:, 1:2])
    color = np.clip(0.5 + 0.35 * direction + bands, 0, 1)
    logits = np.random.default_rng(0).normal(4.0, 1.5, len(vertices))
    settings = {
        name: StoredSetting(0 if name == "sh_degree" else setting.default, "default")
        for name, setting in METHODS["mesh_splatting"].settings.items()
    }
    description = Description(
        method="mesh_splatting",
        coverage={"kernel": "edge_window", "sigma": settings["sigma"].value},
        opacity={"encoding": "logit", "floor": settings["opacity_floor"].value},
        appearance={"kind": "spherical_harmonics"},
        compositing={"kind": "front_to_back"},
        settings=settings,
        coordinate_frame=CoordinateFrame(up="+y"),
    )
    buffers = {
        "positions": vertices,
        "indices": faces.astype(np.uint32),
        "f_dc": ((color - 0.5) / SH_C0).astype(np.float32),
        "opacity": logits.astype(np.float32),
    }
    return build_asset(buffers, {"f_dc": "vertex", "opacity": "vertex"}, description)


if __name__ == "__main__":
    save(splat_like_asset(), HERE / "splat_like.triasset")
