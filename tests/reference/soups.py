"""Random models of each method in memory, and cameras that see them."""

from dataclasses import replace
from typing import Any

import numpy as np

from msb.asset import Asset, Description, build_asset
from msb.asset.manifest import StoredSetting
from msb.asset.sh import SH_C0
from msb.scenes import Camera

SPLATTING = ("two_dts", "triangle_splatting", "mesh_splatting")
METHODS = (*SPLATTING, "diffsoup")

_LOGIT = {"encoding": "logit"}
_DESCRIPTIONS: dict[str, dict[str, Any]] = {
    "two_dts": {"coverage": {"kernel": "gaussian_power", "gamma": 1.0}, "opacity": _LOGIT},
    "triangle_splatting": {
        "coverage": {"kernel": "incentre_window", "sigma_encoding": "exp", "sigma_offset": 0.01},
        "opacity": _LOGIT,
    },
    "mesh_splatting": {"coverage": {"kernel": "edge_window", "sigma": 1e-4}, "opacity": _LOGIT},
}


def front_camera(width: int = 40, height: int = 28, **moved: float) -> Camera:
    """Return a camera at the origin that looks along +z; `moved` overrides cx or cy."""
    place = {"cx": width / 2, "cy": height / 2} | moved
    return Camera(width, height, 42.0, 45.0, place["cx"], place["cy"], np.eye(4))


def random_triangles(seed: int, count: int = 60, size: float = 0.8) -> np.ndarray:
    """Return triangles (count, 3, 3) float32 in front of `front_camera`, all at different depths."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform((-1.2, -0.9, 2.5), (1.2, 0.9, 6.0), (count, 3))
    return (centers[:, None] + rng.normal(scale=size / 2, size=(count, 3, 3))).astype(np.float32)


def soup(
    method: str,
    triangles: np.ndarray,
    *,
    seed: int = 0,
    degree: int = 0,
    settings: dict[str, Any] | None = None,
    welded: bool = False,
    **buffers: np.ndarray,
) -> Asset:
    """Return triangles (F, 3, 3) as a model of `method`; parameters are random unless passed by name.

    With `welded` equal corners share one vertex.
    """
    rng = np.random.default_rng(seed)
    count = len(triangles)
    positions = np.asarray(triangles, np.float32).reshape(-1, 3)
    indices = np.arange(3 * count, dtype=np.uint32).reshape(count, 3)
    if welded:
        positions, indices = weld(triangles)
    rows = len(positions) if method == "mesh_splatting" else count
    arrays: dict[str, Any] = {"positions": positions, "indices": indices}
    if method == "diffsoup":
        opacity = rng.uniform(0.45, 1, (count, 6))
        return lattice_model(positions, indices, 1, seed=seed, opacity=opacity, settings=settings, **buffers)
    arrays["f_dc"] = rng.uniform(-1.5, 1.5, (rows, 3)).astype(np.float32)
    arrays["opacity"] = rng.normal(0.5, 1.5, rows).astype(np.float32)
    if method == "triangle_splatting":
        arrays["sigma"] = rng.uniform(-3, 0.5, rows).astype(np.float32)
    if degree:
        arrays["f_rest"] = rng.normal(scale=0.3, size=(rows, 3 * ((degree + 1) ** 2 - 1))).astype(np.float32)
    arrays |= buffers
    appearance: dict[str, Any] = {"kind": "spherical_harmonics"}
    if degree:
        appearance["f_rest_order"] = "coefficient_major"
    description = Description(
        method=method,
        sh_degree=degree,
        appearance=appearance,
        compositing={"kind": "front_to_back"},
        settings=_stored(settings),
        **_DESCRIPTIONS[method],
    )
    domain: Any = "vertex" if method == "mesh_splatting" else "face"
    return build_asset(arrays, dict.fromkeys(arrays.keys() - {"positions", "indices"}, domain), description)


def weld(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct corners of triangles (F, 3, 3), and for each corner its index in them (F, 3)."""
    corners = np.asarray(triangles, np.float32).reshape(-1, 3)
    positions, numbers = np.unique(corners, axis=0, return_inverse=True)
    return positions, numbers.reshape(-1, 3).astype(np.uint32)


def lattice_model(
    positions: np.ndarray,
    indices: np.ndarray,
    level: int,
    *,
    seed: int = 0,
    opacity: np.ndarray | None = None,
    quantised: bool = False,
    settings: dict[str, Any] | None = None,
    **buffers: np.ndarray,
) -> Asset:
    """Return a DiffSoup model with random features and decoder; opacities are random by default."""
    rng = np.random.default_rng(seed)
    faces, samples = len(indices), (2**level + 1) * (2**level + 2) // 2
    if opacity is None:
        opacity = np.clip(rng.normal(0.6, 0.3, (faces, samples)), 0, 1)
        opacity[::5] = 1
        opacity[1::7] = 0.5  # the initial value, which remains without gradients
    lattices = {"lattice": rng.random((faces, samples, 7)), "opacity": opacity}
    dtype, scale = (np.uint8, 255) if quantised else (np.float32, 1)
    arrays: dict[str, Any] = {f"features.{name}": (a * scale).astype(dtype) for name, a in lattices.items()}
    for layer, outputs in (("mlp.0", 16), ("mlp.2", 16), ("mlp.4", 3)):
        arrays[f"decoder.{layer}.weight"] = rng.normal(0, 0.6, (outputs, 16)).astype(np.float32)
        arrays[f"decoder.{layer}.bias"] = rng.normal(0, 0.3, outputs).astype(np.float32)
    arrays |= buffers
    description = Description(
        method="diffsoup",
        opacity={"encoding": "feature", "threshold": 0.5},
        appearance={
            "kind": "neural_decoder",
            "level": level,
            "feature_encoding": "lut" if quantised else "sigmoid",
            "blend_feature": 3,
            "background": "#000000",
        },
        compositing={"kind": "binary_z_buffer"},
        settings=_stored(settings),
    )
    domains: dict[str, Any] = {name: "global" if name.startswith("decoder") else "face" for name in arrays}
    geometry = {"positions": positions.astype(np.float32), "indices": indices.astype(np.uint32)}
    return build_asset(geometry | arrays, domains, description)


def channel_major(asset: Asset) -> Asset:
    """Return `asset` with the coefficients of `f_rest` in channel-major order."""
    rest = asset.buffers["f_rest"]
    turned = np.ascontiguousarray(rest.reshape(len(rest), -1, 3).transpose(0, 2, 1).reshape(len(rest), -1))
    appearance = {**asset.manifest.appearance, "f_rest_order": "channel_major"}
    manifest = replace(asset.manifest, appearance=appearance)
    return replace(asset, manifest=manifest, buffers={**asset.buffers, "f_rest": turned})


def _stored(settings: dict[str, Any] | None) -> dict[str, StoredSetting]:
    return {name: StoredSetting(value, "flag") for name, value in (settings or {}).items()}


def constant_color(count: int, color: tuple[float, float, float]) -> np.ndarray:
    """Return coefficients `f_dc` (count, 3) that give `color` from all directions."""
    return np.tile(((np.array(color) - 0.5) / SH_C0).astype(np.float32), (count, 1))
