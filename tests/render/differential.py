"""Compare a renderer's frame of a random case with the NumPy reference, ignoring differences by rounding.

The dedicated tier is compared with the float32 reference, the standard tier with its float64 twin. A
difference is explained by rounding if the reference changes in the same way when it runs in another
precision, or when every corner is moved by about the rounding error of float32. Other differences are errors.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import drawn_colors
from msb.cl import Device
from msb.reference import ReferenceFrame, render_reference
from msb.reference.arithmetic import sigmoid
from msb.render import Frame
from msb.render.dedicated import dedicated_renderer
from msb.render.standard.renderer import StandardRenderer
from msb.render.standard.supersampling import box_filter, enlarge
from msb.scenes import Camera
from tests.reference.standard import UNITS, render_standard
from tests.render.frames import frame_of
from tests.render.random_cases import STANDARD, Case

OFF = 2e-3
"""The tolerance of differences.

If the largest value of a plane is above 1, the tolerance is relative to this value, otherwise absolute.
Rounding explains a difference if it moves the reference by a quarter of the tolerance.
"""
MOVES = 16
"""Largest number of reference frames with moved corners."""
ROUNDING = 2.0**-21
"""Relative error of a coordinate after several float32 operations."""


@dataclass(frozen=True)
class Difference:
    """The result of one case.

    Attributes
    ----------
    pixels : int
        Number of pixels of the image.
    off, explained : mapping of str to int
        Field of the frame -> number of pixels (for `visible`: faces) beyond the tolerance, without and with
        rounding as explanation.
    quality : float
        PSNR in dB over the pixels within the tolerance; infinite if they are equal.
    """

    pixels: int
    off: Mapping[str, int]
    explained: Mapping[str, int]
    quality: float


def difference(case: Case, device: Device) -> Difference:
    """Return the difference between the frame that `device` renders and the reference's frame."""
    standard = case.method == STANDARD
    renderer = StandardRenderer if standard else dedicated_renderer
    frame, wanted = draw(renderer, case, device), standard_twin(case) if standard else reference_frame(case)
    wrong = fields_apart(frame, wanted)
    explained = {name: np.zeros_like(where) for name, where in wrong.items()}
    for other in vary_reference(case):
        if all((where == explained[name]).all() for name, where in wrong.items()):
            break
        for name, where in fields_apart(other, wanted, OFF / 4).items():
            if name in wrong:
                explained[name] |= wrong[name] & where
    near = ~wrong["image"]
    error = (frame.image.astype(np.float64) - wanted.image)[near]
    squared = float(np.mean(error**2)) if error.size else 0.0
    peak = max(1.0, float(np.abs(wanted.image).max()))
    return Difference(
        pixels=near.size,
        off={name: n for name in wrong if (n := int((wrong[name] & ~explained[name]).sum()))},
        explained={name: n for name in wrong if (n := int(explained[name].sum()))},
        quality=10 * float(np.log10(peak**2 / squared)) if squared else float("inf"),
    )


def vary_reference(case: Case) -> Iterator[ReferenceFrame]:
    """Yield frames of the reference in another precision, and with corners moved by rounding errors."""
    if case.method == STANDARD:
        yield from (standard_twin(case, seed) for seed in range(MOVES))
    else:
        yield reference_frame(case, np.float64)
        yield from (reference_frame(move_vertices(case, seed)) for seed in range(MOVES))


def draw(make: Any, case: Case, device: Device) -> Frame:
    """Return the frame of `case`, rendered by a renderer of class `make`."""
    return frame_of(
        make, case.asset, device, case.camera, case.background, settings=case.settings, **case.options
    )


def reference_frame(case: Case, dtype: type[Any] = np.float32) -> ReferenceFrame:
    """Return the frame of `case`, rendered by the reference of its method."""
    modes = {name: case.options[name] for name in ("order", "sampling")}
    return render_reference(case.asset, case.camera, case.background, case.settings, dtype, **modes)


def move_vertices(case: Case, seed: int) -> Case:
    """Return `case` with vertices moved by rounding errors; coincident vertices stay coincident.

    The moved positions are float64, which only references accept.
    """
    positions = case.asset.buffers["positions"].astype(np.float64)
    places, numbers = np.unique(positions, axis=0, return_inverse=True)
    moves = roundings(places, case.camera, np.random.default_rng(seed))
    buffers = {**case.asset.buffers, "positions": positions + moves[numbers.reshape(-1)]}
    return replace(case, asset=Asset(case.asset.manifest, MappingProxyType(buffers)))


def standard_twin(case: Case, seed: int | None = None) -> ReferenceFrame:
    """Return the frame of `case` as an opaque mesh, rendered by the NumPy twin of the standard tier.

    With a seed every face is moved separately, because the depths of each face are rounded separately.
    Coincident faces stay coincident.
    """
    buffers, samples = case.asset.buffers, case.options["supersample"]
    positions, indices = buffers["positions"].astype(np.float64), buffers["indices"]
    colors, visible = drawn_colors(case.asset), None
    if (threshold := case.settings.get("ste_threshold")) is not None:
        with np.errstate(over="ignore"):
            visible = sigmoid(buffers["opacity"]) > np.float32(threshold)
    values, domain = colors.values, str(colors.domain)
    if seed is not None:
        if domain == "vertex":
            values, domain = values[indices.reshape(-1)], "corner"
        faces = positions[indices]
        order = np.lexsort(faces.transpose(2, 0, 1)[::-1])[..., None]
        places, numbers = np.unique(np.take_along_axis(faces, order, 1), axis=0, return_inverse=True)
        random = np.random.default_rng(seed)
        moves = roundings(places, case.camera, random) + snapping(places, case.camera, random)
        moves = moves[numbers.reshape(-1)]
        np.put_along_axis(faces, order, np.take_along_axis(faces, order, 1) + moves, 1)
        positions, indices = faces.reshape(-1, 3), np.arange(faces.size // 3).reshape(-1, 3)
    view = enlarge(case.camera, samples)
    frame = render_standard(positions, indices, values, domain, view, case.background, visible)
    return frame if samples == 1 else box_filter(frame, samples)


def roundings(
    points: NDArray[np.float64], camera: Camera, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return random displacements of points (..., 3), of the size of float32 rounding in camera space."""
    pose = camera.world_to_camera
    reach = np.abs(points @ pose[:3, :3].T + pose[:3, 3]).max(axis=-1, keepdims=True)
    return np.asarray(reach * random.normal(size=points.shape) * ROUNDING)


def snapping(points: NDArray[np.float64], camera: Camera, random: np.random.Generator) -> NDArray[np.float64]:
    """Return random displacements of points (..., 3), of the size of the z-buffer's grid of 1/4096 pixel."""
    pose = camera.world_to_camera
    depth = points @ pose[2, :3] + pose[2, 3]
    aside = random.uniform(-0.5, 0.5, points.shape) * (1 / camera.fx, 1 / camera.fy, 0) / UNITS
    return np.asarray(depth[..., None] * aside @ pose[:3, :3])


def fields_apart(frame: Any, wanted: ReferenceFrame, limit: float = OFF) -> dict[str, NDArray[np.bool_]]:
    """Return for each field a mask of the pixels (H, W) or faces that differ between `frame` and `wanted`.

    Fields that `frame` does not have are omitted.
    """
    masks = {}
    for name in ("image", "alpha", "depth", "normal", "depth_median"):
        if getattr(frame, name) is not None:
            masks[name] = apart(getattr(frame, name), getattr(wanted, name), limit)
    for name in ("face_id", "visible"):
        if getattr(frame, name) is not None:
            masks[name] = getattr(frame, name) != getattr(wanted, name)
    for name in frame.raw.keys() & wanted.raw.keys():
        array = wanted.raw[name]
        if np.ndim(array) >= 2 and name not in ("mvp", "mvp_inv"):
            masks[f"raw {name}"] = apart(frame.raw[name], array, limit)
    return masks


def apart(values: Any, right: Any, limit: float) -> NDArray[np.bool_]:
    """Return a mask (H, W) of pixels where two arrays (H, W, ...) differ by more than `limit`, or one is NaN.

    If the largest number of `right` is above 1, the limit is relative to this number.
    """
    first, second = np.asarray(values, np.float64), np.asarray(right, np.float64)
    finite = np.abs(second[np.isfinite(second)])
    scale = max(1.0, float(finite.max(initial=0)))
    with np.errstate(invalid="ignore"):
        wrong = ~((np.abs(first - second) <= limit * scale) | (first == second))
    return np.asarray(wrong.reshape(*wrong.shape[:2], -1).any(axis=-1))
