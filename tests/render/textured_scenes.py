"""Random assets with textures for tests of renderers."""

from dataclasses import replace
from typing import Any

import numpy as np

from msb.asset import Asset, Description, build_asset
from msb.asset.look import tint_of
from msb.asset.texture import Sampler, textures_of
from msb.reference import ReferenceFrame
from msb.scenes import Camera
from tests.reference.standard import render_standard
from tests.render.standard_scenes import BACKGROUND, Arrays, camera, scene

CASES: dict[str, dict[str, Any]] = {
    "minified": {"sampler": Sampler()},
    "several": {
        "sampler": Sampler(wrap_u="mirror", wrap_v="clamp"),
        "sizes": ((33, 20, 3), (1, 7, 4), (128, 64, 3)),
        "tint": "vertex",
    },
    "nearest": {
        "sampler": Sampler(filter="nearest", wrap_u="clamp", wrap_v="mirror"),
        "sizes": ((16, 16, 3),),
        "tint": "face",
    },
    "level 0": {
        "sampler": Sampler(mipmaps=False, alpha_cutoff=0.5),
        "sizes": ((5, 5, 4),),
        "tint": "corner",
        "spread": 0.3,
    },
    "cut out": {"sampler": Sampler(alpha_cutoff=0.3), "sizes": ((32, 32, 4), (8, 8, 4)), "spread": 0.1},
}
"""Name -> arguments of `textured_asset`: filters, wrap modes, sizes, texture counts, tints and cutoffs."""


def textured_asset(
    mesh: Arrays,
    seed: int,
    *,
    sampler: Sampler,
    sizes: tuple[tuple[int, int, int], ...] = ((64, 64, 3),),
    tint: str | None = None,
    spread: float = 1.0,
) -> Asset:
    """Return `mesh` with noise textures of `sizes`, and texture coordinates from -1 to 2 times `spread`."""
    random = np.random.default_rng(seed)
    positions, indices = mesh
    uvs = random.uniform(-1, 2, (indices.size, 2)) * spread
    buffers: dict[str, Any] = {"positions": positions, "indices": indices, "uv": uvs.astype(np.float32)}
    domains: dict[str, Any] = {"uv": "corner"}
    for number, size in enumerate(sizes):
        buffers[f"texture.{number}"] = random.integers(0, 256, size, dtype=np.uint8)
        domains[f"texture.{number}"] = "global"
    if len(sizes) > 1:
        buffers["face_texture"] = random.integers(0, len(sizes), len(indices)).astype(np.uint32)
        domains["face_texture"] = "face"
    if tint is not None:
        count = {"vertex": len(positions), "face": len(indices), "corner": indices.size}[tint]
        buffers["color"] = random.integers(0, 256, (count, 4), dtype=np.uint8)
        domains["color"] = tint
    return build_asset(buffers, domains, Description(appearance=sampler.appearance))


def textured_twin(asset: Asset, view: Camera) -> ReferenceFrame:
    """Return the frame of `asset`, rendered by the float64 twin."""
    tint, buffers = tint_of(asset), asset.buffers
    colors, domain = (None, "corner") if tint is None else (tint.values, tint.domain)
    mesh = buffers["positions"], buffers["indices"]
    return render_standard(*mesh, colors, domain, view, BACKGROUND, textured=textures_of(asset))


def golden_scene(case: str) -> tuple[Asset, Camera]:
    """Return the asset and the camera of a case in `tests/golden/textures`: large faces with textures."""
    view = replace(camera(83, 61, 70.0, (37.0, 33.5)), fx=78.0)
    return textured_asset(scene("large", 3), 4, **CASES[case]), view
