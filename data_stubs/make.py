"""Create the data in this folder: `python -m data_stubs.make`. The same scripts give the same bytes.

The data are an asset and a checkpoint with the structure of trained models, and a small scene in the layout
of each dataset (`data_stubs.captures`). Models of the scenes are trained by `data_stubs.trainings`.
Photographs are compressed by Pillow, so their bytes depend on the version of Pillow. The pixels of PNG files
do not, and the pixels of JPEG files differ by at most one level.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from data_stubs import captures
from data_stubs.photographs import photograph
from data_stubs.splat_like import splat_like
from data_stubs.still_life import pebbles, pebbles_before_a_wall
from data_stubs.torch_file import write_torch
from msb.asset import Asset, Description, build_asset, write_asset
from msb.asset.manifest import CoordinateFrame, StoredSetting
from msb.asset.sh import SH_C0
from msb.registry import METHODS
from msb.scenes import Camera, turntable, write_cameras

HERE = Path(__file__).parent
SIZE = 36
"""Side of the demo mesh's lattice: about 35 thousand faces, 1 % of a real export."""

CHECKPOINT_SIZE = 14
"""Side of the demo checkpoint's lattice."""


def splat_like_asset(n: int = SIZE) -> Asset:
    """Return an asset like a MeshSplatting export. Colours depend on the direction from the centre.


    Vertex opacities are logits as in a trained model: most are opaque.
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


def write_checkpoint(folder: Path, n: int = CHECKPOINT_SIZE) -> None:
    """Write a MeshSplatting checkpoint of the same kind of mesh, with SH degree 1."""
    vertices, faces = splat_like(n)
    count, random = len(vertices), np.random.default_rng(1)
    direction = vertices - np.float32(0.5)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    values = {
        "triangles_points": vertices,
        "_triangle_indices": faces.astype(np.int32),
        "vertex_weight": random.normal(4.0, 1.5, (count, 1)).astype(np.float32),
        "sigma": math.log(1e-4),
        "active_sh_degree": 1,
        "features_dc": (0.35 * direction / SH_C0).astype(np.float32)[:, None],
        "features_rest": random.normal(0, 0.05, (count, 3, 3)).astype(np.float32),
        "importance_score": np.ones(len(faces), np.float32),
        "image_size": np.full(len(faces), 20, np.float32),
        "pixel_count": np.full(len(faces), 100, np.int32),
    }
    model = folder / "point_cloud" / "iteration_30000"
    model.mkdir(parents=True, exist_ok=True)
    write_torch(model / "point_cloud_state_dict.pt", values, "point_cloud_state_dict")
    arguments = (
        "sh_degree=1, source_path='data/demo', model_path='output/demo', images='images', resolution=-1, "
    )
    arguments += "white_background=True, data_device='cuda', eval=True"
    (folder / "cfg_args").write_text(f"Namespace({arguments})")


def cameras() -> list[Camera]:
    """Return eight cameras around the demo meshes, which fill the unit cube."""
    center = (0.5, 0.5, 0.5)
    return turntable(center, 2.4, up=(0, 1, 0), count=8, width=640, height=480, fov_y=0.7, elevation=0.35)


WORLD = captures.World(
    name="pebble",
    alone=pebbles,
    inside=pebbles_before_a_wall,
    photograph=photograph,
    views=57,
    around={"train": 24, "test": 8},
    sizes={
        "mipnerf360": (960, 720),
        "tanksandtemples": (240, 180),
        "nerf_synthetic": (240, 240),
        "dtu": (240, 180),
    },
    reduced={"images_4": 4, "images_8": 8},
    quality=85,
    levels=64,
    points=3000,
    scanned=3000,
)
"""Content of the shipped scenes. Mip-NeRF 360's largest photographs are left out; they have megabytes."""


if __name__ == "__main__":
    captures.write_scenes(WORLD, HERE / "scenes")
    write_cameras(cameras(), HERE / "views.json", background=(1, 1, 1))
    write_checkpoint(HERE / "checkpoint")
    write_asset(splat_like_asset(), HERE / "splat_like.triasset")
