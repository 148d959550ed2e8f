"""The lens of a frame in transforms.json: the distortion keys of instant-ngp and nerfstudio."""

from collections.abc import Callable

from msb.scenes.distortion import Distortion, make_distortion
from msb.scenes.json_node import Node

_PERSPECTIVE = {"", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
_FULL = "FULL_OPENCV"
_FISHEYE = {"OPENCV_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
# nerfstudio's name for COLMAP's RAD_TAN_THIN_PRISM_FISHEYE.
_ARIA = "FISHEYE624"
_KEYS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def read_distortion(find: Callable[[str], Node | None]) -> Distortion | None:
    """Return the distortion of a frame. For a pinhole camera, return None.

    The function `find` returns the value of a key. Keys of the frame take precedence over keys of the
    document. `camera_model` may be in upper or lower case. A frame is a fisheye image if its camera model is
    a fisheye model. A frame is also a fisheye image if `is_fisheye` or `fisheye` is true. The coefficients
    are k1 to k6, p1 and p2, or `distortion_params`. `distortion_params` has four, five or eight values in
    OpenCV's order, six in nerfstudio's order (k1 to k4, p1, p2), or twelve for FISHEYE624. Raise
    CAMERA_DISTORTED for images without a lens model (panoramas, orthophotos).
    """
    model = find("camera_model")
    name = "" if model is None else model.text().upper()
    is_fisheye = name in _FISHEYE or any(_is_set(find(key)) for key in ("is_fisheye", "fisheye"))
    if model is not None and name not in _PERSPECTIVE | _FISHEYE | {_FULL, _ARIA}:
        text = (
            f"the camera model {model.abbreviated()} is not a known lens (pinhole, radial, OPENCV, fisheye "
            "or FISHEYE624); cut panoramas into perspective images"
        )
        raise model.error("CAMERA_DISTORTED", text)
    values = {key: node.number() for key in _KEYS if (node := find(key)) is not None}
    k1, k2, k3, k4, k5, k6, p1, p2 = (values.get(key, 0.0) for key in _KEYS)
    listed = find("distortion_params")
    if listed is not None and not any(values.values()):
        numbers = [node.number() for node in listed.items()]
        if name == _ARIA and len(numbers) == 12:
            with listed.locating():
                return make_distortion("RAD_TAN_THIN_PRISM_FISHEYE", numbers)
        if len(numbers) == 6:
            k1, k2, k3, k4, p1, p2 = numbers
        elif is_fisheye and len(numbers) == 4:
            k1, k2, k3, k4 = numbers
        elif len(numbers) in (4, 5, 8):
            k1, k2, p1, p2, k3, k4, k5, k6 = (*numbers, 0.0, 0.0, 0.0, 0.0)[:8]
            name = _FULL if len(numbers) == 8 else name
        else:
            raise listed.wrong_type("4, 5, 6 or 8 numbers, or 12 for FISHEYE624")
    # Choose the distortion formula of the program that wrote the file.
    kind: str
    coefficients: tuple[float, ...]
    if is_fisheye:
        kind, coefficients = "OPENCV_FISHEYE", (k1, k2, k3, k4)
    elif name == _FULL or k5 or k6:
        kind, coefficients = _FULL, (k1, k2, p1, p2, k3, k4, k5, k6)
    elif k4:
        kind, coefficients = "NERFSTUDIO", (k1, k2, k3, k4, p1, p2)
    else:
        kind, coefficients = "OPENCV", (k1, k2, p1, p2, *([k3] if k3 else ()))
    return make_distortion(kind, coefficients)


def _is_set(flag: Node | None) -> bool:
    """Return whether a flag is set: the JSON value true, or a number other than 0."""
    return flag is not None and (flag.value is True or (flag.value is not False and flag.number() != 0))
