"""Where the splatting methods differ on the host: settings, activations, names of outputs.

On the device they differ in one file each, `splat_<method>.cl`. A new method is that file, a function that
returns its `Model`, and a line in `METHODS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.asset.drawable import required_buffer
from msb.errors import AssetError
from msb.render.splat_view import Culling

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from msb.asset import Asset

    Settings = Mapping[str, Any]

_CHUNK = 1 << 16
_ENGINE_NEAR = 0.01
"""ENGINE_NEAR in splat_engine.cl."""
_CLIPPED = Culling(nearest=_ENGINE_NEAR, dilation=1.0, clipped=True)


@dataclass(frozen=True)
class Model:
    """An asset as the kernels take it: activated, with the settings that hold.

    Attributes
    ----------
    program : str
        Kernel file.
    face_words, engine_words : int
        Size of its struct `Face`, in words of four bytes; the latter for an engine's sampling.
    defines : mapping
        What the file is compiled with.
    near, far : float
        Planes of the official projection matrix.
    culling, engine_culling : Culling
    scale : int
        Samples per pixel along each axis.
    box_mean : bool
        Pixels are means of all their samples; else they are interpolated bilinearly.
    fields : mapping
        Members of `View` that the settings decide.
    positions : (V, 3) float32
    coverage : (n, c) float32
        Activated opacity of faces or vertices, and what it and the falloff decide whatever the view; each
        method's kernel file says which values.
    vertex_colors : bool
        Colours and opacities belong to vertices, else to faces.
    outputs : tuple of str
        Optional fields of a frame that the method defines.
    raw : mapping
        Name of the official kernel's buffer -> our plane.
    """

    program: str
    face_words: int
    engine_words: int
    positions: NDArray[np.float32]
    coverage: NDArray[np.float32]
    near: float
    far: float
    culling: Culling
    raw: Mapping[str, str]
    outputs: tuple[str, ...]
    defines: Mapping[str, bool] = field(default_factory=dict)
    scale: int = 1
    box_mean: bool = False
    fields: Mapping[str, Any] = field(default_factory=dict)
    vertex_colors: bool = False
    engine_culling: Culling = _CLIPPED


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 / (1 + exp(-x)), each step rounded to float32, as torch evaluates it; exp in double."""
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + _exponential(-logits)), np.float32)


def _exponential(x: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return np.exp(x, dtype=np.float64).astype(np.float32)


def rescale(positions: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Return triangles, rows of three corners, shrunk so that gamma keeps their total opacity.

    The factor is 1 / sqrt(2^b b Gamma(b)) with b = 1 / gamma, in double and rounded (GaodeRender/
    triangle-splatting: src/diff_recon/models/VanillaTS_model.py).
    """
    beta = 1 / gamma
    factor = np.float32(1 / math.sqrt(2**beta * beta * math.gamma(beta)))
    found = np.zeros_like(positions)
    for start in range(0, len(positions), 3 * _CHUNK):
        part = positions[start : start + 3 * _CHUNK].reshape(-1, 3, 3)
        center = ((part[:, 0] + part[:, 1] + part[:, 2]) / np.float32(3))[:, None]
        found[start : start + 3 * _CHUNK] = ((part - center) * factor + center).reshape(-1, 3)
    return found


def _reach(opacity: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Return a little more than the eccentricity at which o exp(-ecc^(2 gamma) / 2) = 1/255, at most 10.

    -1 where alpha is below 1/255 even at the centroid.
    """
    with np.errstate(divide="ignore"):
        squared = 2 * np.log(255.0 * opacity.astype(np.float64)) + 1e-5
    limit = np.maximum(squared, 1e-30) ** (1 / (2 * gamma)) * 1.0001
    return np.where(squared > 0, np.minimum(limit, 10), -1).astype(np.float32)


def _rim(opacity: NDArray[np.float32], sigma: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Return a little less than the phi at which o phi^sigma = 1/255; 2 where alpha is less everywhere."""
    share = 1 / (255.0 * np.maximum(opacity, 1e-30).astype(np.float64))
    rim = np.minimum(share, 1) ** (1 / sigma.astype(np.float64)) * 0.9999
    return np.where(share < 1.0001, rim, 2).astype(np.float32)


def _two_dts(asset: Asset, settings: Settings) -> Model:
    positions = _soup(asset)
    if settings["gamma_rescale"]:
        positions = rescale(positions, settings["gamma"])
    opacity = sigmoid(required_buffer(asset, "opacity", asset.manifest.face_count))
    if settings["ste_threshold"] is not None:
        step = (opacity > np.float32(settings["ste_threshold"])).astype(np.float32)
        opacity = (step - opacity) + opacity  # as upstream forms it: 1 may be off by one ulp
    return Model(
        program="splat_two_dts",
        face_words=24,
        engine_words=32,
        defines={"PLANAR": settings["rasterizer"] == "3D"},
        positions=positions,
        coverage=np.stack([opacity, _reach(opacity, settings["gamma"])], axis=1),
        near=1.0,
        far=1000.0,
        culling=Culling(nearest=1.0, dilation=3.0),
        engine_culling=replace(_CLIPPED, dilation=10.0),
        scale=settings["render_up_scale"] or 1,
        fields={
            "power": np.float32(2) * np.float32(settings["gamma"]),
            "back_culling": settings["back_culling"],
        },
        outputs=("normal",),
        raw={"transmittance": "transmittance", "depth": "depth_over_background", "normal": "normal"},
    )


def _triangle_splatting(asset: Asset, settings: Settings) -> Model:
    _require(asset, "coverage", "sigma_encoding", "exp")
    count = asset.manifest.face_count
    offset = np.float32(asset.manifest.coverage.get("sigma_offset", 0))
    opacity = sigmoid(required_buffer(asset, "opacity", count))
    sigma = offset + _exponential(required_buffer(asset, "sigma", count))
    with np.errstate(divide="ignore"):
        # The official fast power, each step rounded: o phi^sigma = 0.01 there.
        power = (1 / sigma) * np.log2(np.float32(0.01) / opacity, dtype=np.float64).astype(np.float32)
    with np.errstate(over="ignore"):
        shrunk = np.exp2(power, dtype=np.float64).astype(np.float32)
    return Model(
        program="splat_triangle_splatting",
        face_words=24,
        engine_words=32,
        positions=_soup(asset),
        coverage=np.stack([opacity, sigma, shrunk, _rim(opacity, sigma)], axis=1),
        near=0.01,
        far=100.0,
        # Where two edges are nearly parallel (a determinant of 1e-3) rounding moves their intersection by up
        # to 0.1 % of its distance from the first sample, which is at most a side of the raster, which
        # `Culling` adds, and the 1600 samples beyond that a face may reach.
        culling=Culling(nearest=0.2, dilation=1.0, margin=8.0),
        fields={"broadcast_z": settings["view_dir"] == "broadcast_z"},
        outputs=("normal", "depth_median"),
        raw={
            "alpha": "alpha",
            "depth_accum": "depth",
            "depth_median": "depth_median",
            "normal_accum": "normal",
        },
    )


def _mesh_splatting(asset: Asset, settings: Settings) -> Model:
    floor, scale = settings["opacity_floor"], settings["supersample"]
    logits = required_buffer(asset, "opacity", asset.manifest.vertex_count)
    opacity = np.float32(floor) + np.float32(1 - floor) * sigmoid(logits)
    prefix = f"ss{scale}_"
    return Model(
        program="splat_mesh_splatting",
        face_words=40,
        engine_words=32,
        positions=asset.buffers["positions"],
        coverage=np.stack([opacity, _rim(opacity, np.float32(settings["sigma"]))], axis=1),
        near=0.01,
        far=100.0,
        culling=Culling(nearest=0.2, dilation=1.0, margin=7.0),
        scale=scale,
        box_mean=True,
        fields={"sigma": settings["sigma"]},
        vertex_colors=True,
        outputs=("normal", "depth_median", "face_id"),
        raw={
            f"{prefix}image": "image",
            f"{prefix}alpha": "alpha",
            f"{prefix}depth_expected": "depth",
            f"{prefix}depth_median": "depth_median",
            f"{prefix}normal_cam": "normal",
            f"{prefix}face_id": "face_id",
        },
    )


METHODS: Mapping[str, Callable[[Asset, Settings], Model]] = MappingProxyType(
    {
        "gaussian_power": _two_dts,
        "incentre_window": _triangle_splatting,
        "edge_window": _mesh_splatting,
    }
)
"""Coverage kernel of the manifest -> what makes a model of such an asset."""


def make_model(asset: Asset, settings: Settings) -> Model:
    """Return `asset` as the kernels take it.

    Raises
    ------
    AssetError
        `TRIASSET_FIELD_VALUE`: coverage, opacity or appearance of a kind we do not know;
        `TRIASSET_BUFFER_REQUIRED`, `TRIASSET_BUFFER_SHAPE`: a buffer the method needs.
    """
    make = METHODS.get(kind := str(asset.manifest.coverage.get("kernel")))
    if make is None:
        text = f"coverage.kernel is {kind!r:.40}; the dedicated renderer knows {', '.join(METHODS)}"
        raise AssetError(
            "TRIASSET_FIELD_VALUE", text, file=asset.path, pointer="/coverage/kernel", value=kind
        )
    _require(asset, "opacity", "encoding", "logit")
    return make(asset, settings)


def sh_buffers(asset: Asset, rows: int) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return `f_dc`, and `f_rest` in the order coefficient, channel (None at degree 0)."""
    first = required_buffer(asset, "f_dc", rows, 3)
    degree = asset.manifest.sh_degree
    if degree == 0:
        return first, None
    rest = required_buffer(asset, "f_rest", rows, 3 * ((degree + 1) ** 2 - 1))
    if asset.manifest.appearance.get("f_rest_order") == "coefficient_major":
        return first, rest
    turned = rest.reshape(rows, 3, -1).transpose(0, 2, 1)
    return first, np.ascontiguousarray(turned).reshape(rest.shape)


def _soup(asset: Asset) -> NDArray[np.float32]:
    """Return positions as rows of three corners a face, whatever the indices are."""
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    if asset.manifest.topology == "triangle_soup":
        return positions
    return np.asarray(positions[indices.reshape(-1)])


def _require(asset: Asset, section: str, key: str, value: str) -> None:
    found = getattr(asset.manifest, section).get(key)
    if found != value:
        text = f"{section}.{key} is {found!r:.40}; the dedicated renderer knows {value!r}"
        pointer = f"/{section}/{key}"
        raise AssetError("TRIASSET_FIELD_VALUE", text, file=asset.path, pointer=pointer, value=found)
