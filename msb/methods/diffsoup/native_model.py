"""The checked arrays of an asset, and the matrices of a camera, for native rendering of DiffSoup.

`native` renders in OpenCL; `surface_model` describes the model for WebGPU (diffsoup.wgsl).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.drawable import check_drawable, require, required_buffer
from msb.asset.planes import invert_projection
from msb.errors import AssetError
from msb.methods.diffsoup import FEATURES, LAYERS, check_level, samples
from msb.render.surface import Surface
from msb.scenes import Camera

# Minimum opacity of an opaque sample.
THRESHOLD = 0.5
# The margin exceeds the rounding error of interpolation for values up to 2.
_MARGIN = 1e-5


@dataclass(frozen=True)
class DiffSoupModel:
    """A DiffSoup model with checked values.

    Attributes
    ----------
    positions : (V, 3) float32
    indices : (F, 3) uint32
    features : (F, S, 7) float32 or uint8
        A byte v means v / 255.
    opacity : (F, S), with the dtype of `features`
    opaque : (F,) uint8
        The value is 1 for faces whose interpolated opacity cannot be below the threshold.
    decoder : (595,) float32
        Weights [out][in] and biases of each layer, one layer after another.
    level : int
        The level of the lattices, which have S = (2^level + 1)(2^level + 2) / 2 samples.
    """

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    features: NDArray[Any]
    opacity: NDArray[Any]
    opaque: NDArray[np.uint8]
    decoder: NDArray[np.float32]
    level: int


def diffsoup_model(asset: Asset, *, quantise: bool = False) -> DiffSoupModel:
    """Return the model of an asset; only the decoder is copied.

    Parameters
    ----------
    asset : Asset
        An asset with `compositing.kind` "binary_z_buffer" in its manifest.
    quantise : bool
        Whether lattices of numbers are converted to bytes by the formula of the official web export, which is
        trunc(clip(255 x, 0, 255)) with the product in float32 (kenji-tojo/diffsoup:
        examples/06_export_web.py).
    """
    require(asset, "compositing", "kind", "binary_z_buffer")
    level = check_level(asset.manifest.appearance.get("level"), asset.path)
    check_drawable(asset)
    faces = asset.manifest.face_count
    positions = required_buffer(asset, "positions", asset.manifest.vertex_count, 3)
    indices = required_buffer(asset, "indices", faces, 3)
    features = required_buffer(asset, "features.lattice", faces, samples(level), FEATURES)
    opacity = required_buffer(asset, "features.opacity", faces, samples(level))
    if features.dtype != opacity.dtype:
        text = f"features.lattice is {features.dtype}, but features.opacity is {opacity.dtype}; use one type"
        raise AssetError("TRIASSET_BUFFER", text, file=asset.path, pointer="/buffers/features.opacity")
    if quantise:
        features, opacity = _as_bytes(features), _as_bytes(opacity)
    net = []
    for layer, shape in LAYERS.items():
        net += [
            required_buffer(asset, f"decoder.{layer}.weight", *shape),
            required_buffer(asset, f"decoder.{layer}.bias", shape[0]),
        ]
    decoder = np.concatenate([array.reshape(-1) for array in net], dtype=np.float32)
    return DiffSoupModel(positions, indices, features, opacity, _always_opaque(opacity), decoder, level)


def _as_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return lattice values in [0, 1] truncated to bytes; bytes are returned unchanged."""
    if values.dtype == np.uint8:
        return values
    return np.asarray(np.clip(values * np.float32(255), 0, 255), np.uint8)


def _always_opaque(opacity: NDArray[Any]) -> NDArray[np.uint8]:
    """Return 1 for each face whose samples all exceed the threshold by the margin, otherwise 0."""
    scale = 255 if opacity.dtype == np.uint8 else 1
    low, high = opacity.min(axis=1), opacity.max(axis=1)
    return np.asarray((low >= (THRESHOLD + _MARGIN) * scale) & (high <= 2 * scale), np.uint8)


def diffsoup_matrices(
    camera: Camera, layout: str, near: float, far: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return DiffSoup's matrix MVP = P V and its inverse.

    Parameters
    ----------
    camera : Camera
        The camera has OpenCV axes in both layouts.
    layout : {"colmap", "synthetic"}
        "colmap": the matrix V negates the camera's z, and NDC y grows downwards. The official sign of cy is
        the opposite of the correct sign. "synthetic": the matrix V negates y and z, and NDC y grows upwards.
        The official code assumes a principal point in the middle, but this function supports any principal
        point.
    near, far : float
        Camera depths in scene units that become NDC -1 and 1.

    Returns
    -------
    mvp, inverse : (4, 4) float32
        Matrices for column vectors (x, y, z, 1); clip w is the camera's z.

    Notes
    -----
    Formulas: kenji-tojo/diffsoup: examples/utils.py ("colmap", in float32 from a float32 K),
    examples/02_synthetic.py ("synthetic", in double, then rounded). The matrix product is summed from first
    to last, like the official product on a CPU. The inverse is computed in double and rounded, because the
    last bits of the official float32 inverse depend on the linear algebra library.
    """
    real: Any = np.float32 if layout == "colmap" else np.float64
    width, height, two, unit = real(camera.width), real(camera.height), real(2), real(1)
    fx, fy, cx, cy = real(camera.fx), real(camera.fy), real(camera.cx), real(camera.cy)
    projection = np.zeros((4, 4), np.float32)
    projection[0, 0] = two * fx / width
    projection[1, 1] = two * fy / height
    projection[0, 2] = unit - two * (cx / width)
    projection[1, 2] = two * (cy / height) - unit
    projection[3, 2] = -1
    # invalid planes may cause a division by zero; `invert_projection` rejects these planes
    near, far = np.float64(near), np.float64(far)
    with np.errstate(all="ignore"):
        projection[2, 2] = (far + near) / (near - far)
        projection[2, 3] = 2 * far * near / (near - far)
    signs = (1, 1, -1, 1) if layout == "colmap" else (1, -1, -1, 1)
    view = (np.diag(signs) @ camera.world_to_camera).astype(np.float32)
    with np.errstate(all="ignore"):
        mvp = projection[:, :1] * view[0]
        for k in range(1, 4):  # the operator @ is not used, because BLAS fuses and reorders the sums
            mvp = mvp + projection[:, k : k + 1] * view[k]
    return mvp, invert_projection(mvp, near, far)


def pixel_centers(size: int, padded: int) -> NDArray[np.float32]:
    """Return the NDC coordinates of `size` pixel centres, padded with zeros to (padded,)."""
    centers = np.zeros(padded, np.float32)
    centers[:size] = np.float32(-1) + np.float32(2) * (
        np.arange(size, dtype=np.float32) + np.float32(0.5)
    ) / np.float32(size)
    return centers


def surface_model(asset: Asset, settings: Mapping[str, Any]) -> Surface:
    """Return the arrays and settings of `asset` in the form that diffsoup.wgsl reads."""
    model = diffsoup_model(asset)
    layout, near, far = settings["layout"], settings["z_near"], settings["z_far"]

    def projection(camera: Camera) -> NDArray[np.float32]:
        return diffsoup_matrices(camera, layout, near, far)[0]

    return Surface(
        program="diffsoup",
        package=__package__,
        positions=model.positions,
        coverage=model.opaque.astype(np.float32)[:, None],
        near=near,
        far=far,
        method_values={"flip": np.uint32(layout == "synthetic")},
        indices=model.indices,
        opacity=model.opacity,
        features=model.features,
        decoder=_pack_blocks(model.decoder),
        level=model.level,
        projection=projection,
    )


def _pack_blocks(decoder: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the weights of the decoder in 4 x 4 blocks, each stored by columns, and then all biases."""
    weights, biases, first = [], [], 0
    for outputs, inputs in LAYERS.values():
        padding = -outputs % 4
        last = first + outputs * inputs
        weight = np.pad(decoder[first:last].reshape(outputs, inputs), ((0, padding), (0, 0)))
        weights.append(weight.reshape(-1, 4, inputs // 4, 4).transpose(0, 2, 3, 1).ravel())
        first = last + outputs
        biases.append(np.pad(decoder[last:first], (0, padding)))
    return np.concatenate(weights + biases)
