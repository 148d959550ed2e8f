"""How far a renderer's frame of a random case is from the NumPy reference's, and what rounding explains.

The dedicated tier is compared with the float32 reference, the standard tier with its float64 twin. What
rounding decides is no error: it is one where the reference shows the same in another precision, and with
every corner moved by about as much as float32 rounds.
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
from msb.reference.standard import UNITS, render_standard
from msb.render import Frame
from msb.render.dedicated import dedicated_renderer
from msb.render.standard.renderer import StandardRenderer
from msb.render.standard.supersampling import box_filter, enlarged
from msb.scenes import Camera
from tests.render.frames import frame_of
from tests.render.random_cases import STANDARD, Case

OFF = 2e-3
"""What is farther from the reference is off; of large numbers, this share of the largest. Rounding explains
it if it moves the reference by a quarter of this."""
MOVES = 16
"""How often the reference draws again, at the most, to see what rounding moves."""
ROUNDING = 2.0**-21
"""Share of a coordinate that several operations in float32 may round away."""


@dataclass(frozen=True)
class Difference:
    """What one case shows.

    Attributes
    ----------
    pixels : int
        Of the image.
    off, explained : mapping of str to int
        Field of the frame -> pixels that are off (`visible`: faces), without and with rounding as the reason.
    quality : float
        PSNR in dB of the image's pixels that are not off; infinite if they are equal.
    """

    pixels: int
    off: Mapping[str, int]
    explained: Mapping[str, int]
    quality: float


def difference(case: Case, device: Device) -> Difference:
    """Return how far the frame that `device` draws is from the reference's."""
    standard = case.method == STANDARD
    renderer = StandardRenderer if standard else dedicated_renderer
    frame, wanted = draw(renderer, case, device), standard_twin(case) if standard else own_look(case)
    wrong = fields_apart(frame, wanted)
    explained = {name: np.zeros_like(where) for name, where in wrong.items()}
    for other in others(case):
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
        off={name: found for name in wrong if (found := int((wrong[name] & ~explained[name]).sum()))},
        explained={name: found for name in wrong if (found := int(explained[name].sum()))},
        quality=10 * float(np.log10(peak**2 / squared)) if squared else float("inf"),
    )


def others(case: Case) -> Iterator[ReferenceFrame]:
    """Yield what the reference shows in another precision, and with its corners moved by roundings."""
    if case.method == STANDARD:
        yield from (standard_twin(case, seed) for seed in range(MOVES))
    else:
        yield own_look(case, np.float64)
        yield from (own_look(moved(case, seed)) for seed in range(MOVES))


def draw(make: Any, case: Case, device: Device) -> Frame:
    """Return the frame of `case` by a renderer of class `make`."""
    return frame_of(
        make, case.asset, device, case.camera, case.background, settings=case.settings, **case.options
    )


def own_look(case: Case, dtype: type[Any] = np.float32) -> ReferenceFrame:
    """Return the frame of `case` by the reference of its method."""
    modes = {name: case.options[name] for name in ("order", "sampling")}
    return render_reference(case.asset, case.camera, case.background, case.settings, dtype, **modes)


def moved(case: Case, seed: int) -> Case:
    """Return `case` with its vertices moved by roundings; vertices in one place stay in one place.

    Positions are float64 then, as nothing but a reference takes them.
    """
    positions = case.asset.buffers["positions"].astype(np.float64)
    places, numbers = np.unique(positions, axis=0, return_inverse=True)
    moves = roundings(places, case.camera, np.random.default_rng(seed))
    buffers = {**case.asset.buffers, "positions": positions + moves[numbers.reshape(-1)]}
    return replace(case, asset=Asset(case.asset.manifest, MappingProxyType(buffers)))


def standard_twin(case: Case, seed: int | None = None) -> ReferenceFrame:
    """Return the frame of the opaque mesh that `case` is by the twin of the standard tier.

    With a seed every face is moved for itself, since each rounds its own depths; faces in one place stay in
    one place.
    """
    buffers, samples = case.asset.buffers, case.options["supersample"]
    positions, indices = buffers["positions"].astype(np.float64), buffers["indices"]
    colors, shown = drawn_colors(case.asset), None
    if (threshold := case.settings.get("ste_threshold")) is not None:
        with np.errstate(over="ignore"):
            shown = sigmoid(buffers["opacity"]) > np.float32(threshold)
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
    view = enlarged(case.camera, samples)
    frame = render_standard(positions, indices, values, domain, view, case.background, shown)
    return frame if samples == 1 else box_filter(frame, samples)


def roundings(
    points: NDArray[np.float64], camera: Camera, random: np.random.Generator
) -> NDArray[np.float64]:
    """Return how far float32 may move points (..., 3): shares of their place in the camera's space."""
    pose = camera.world_to_camera
    reach = np.abs(points @ pose[:3, :3].T + pose[:3, 3]).max(axis=-1, keepdims=True)
    return np.asarray(reach * random.normal(size=points.shape) * ROUNDING)


def snapping(points: NDArray[np.float64], camera: Camera, random: np.random.Generator) -> NDArray[np.float64]:
    """Return how far the z-buffer's grid of 1/4096 pixel may move points (..., 3) of the world."""
    pose = camera.world_to_camera
    depth = points @ pose[2, :3] + pose[2, 3]
    aside = random.uniform(-0.5, 0.5, points.shape) * (1 / camera.fx, 1 / camera.fy, 0) / UNITS
    return np.asarray(depth[..., None] * aside @ pose[:3, :3])


def fields_apart(frame: Any, wanted: ReferenceFrame, limit: float = OFF) -> dict[str, NDArray[np.bool_]]:
    """Return field -> pixels (H, W), or faces, in which `frame` is not as `wanted`; of fields that it has."""
    found = {}
    for name in ("image", "alpha", "depth", "normal", "depth_median"):
        if getattr(frame, name) is not None:
            found[name] = apart(getattr(frame, name), getattr(wanted, name), limit)
    for name in ("face_id", "visible"):
        if getattr(frame, name) is not None:
            found[name] = getattr(frame, name) != getattr(wanted, name)
    for name in frame.raw.keys() & wanted.raw.keys():
        array = wanted.raw[name]
        if np.ndim(array) >= 2 and name not in ("mvp", "mvp_inv"):
            found[f"raw {name}"] = apart(frame.raw[name], array, limit)
    return found


def apart(found: Any, right: Any, limit: float) -> NDArray[np.bool_]:
    """Return where (H, W) two arrays (H, W, ...) are farther apart than `limit`, or one is no number.

    The limit is a share of the largest number of `right` if that is above 1.
    """
    first, second = np.asarray(found, np.float64), np.asarray(right, np.float64)
    finite = np.abs(second[np.isfinite(second)])
    scale = max(1.0, float(finite.max(initial=0)))
    with np.errstate(invalid="ignore"):
        wrong = ~((np.abs(first - second) <= limit * scale) | (first == second))
    return np.asarray(wrong.reshape(*wrong.shape[:2], -1).any(axis=-1))
