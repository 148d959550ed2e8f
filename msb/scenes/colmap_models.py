"""COLMAP's camera models, and which of them are pinhole cameras.

Names, ids and the order of parameters: `colmap/colmap`: src/colmap/sensor/models.h. Parameters are the focal
lengths (one for both axes, or fx and fy), cx, cy, and what the lens distorts.
"""

from dataclasses import dataclass
from typing import NamedTuple

from msb.errors import SceneError, shorten
from msb.scenes.checks import MIN_FOCAL, check_pixels, check_size


class Model(NamedTuple):
    """A camera model.

    `fisheye` marks projections that are not those of a pinhole camera even if all distortion is zero.
    """

    number: int
    focals: int
    distortions: int
    fisheye: bool = False

    @property
    def parameters(self) -> int:
        """The number of parameters that a camera of this model has."""
        return self.focals + 2 + self.distortions


MODELS = {
    "SIMPLE_PINHOLE": Model(0, 1, 0),
    "PINHOLE": Model(1, 2, 0),
    "SIMPLE_RADIAL": Model(2, 1, 1),
    "RADIAL": Model(3, 1, 2),
    "OPENCV": Model(4, 2, 4),
    "OPENCV_FISHEYE": Model(5, 2, 4, fisheye=True),
    "FULL_OPENCV": Model(6, 2, 8),
    "FOV": Model(7, 2, 1),
    "SIMPLE_RADIAL_FISHEYE": Model(8, 1, 1, fisheye=True),
    "RADIAL_FISHEYE": Model(9, 1, 2, fisheye=True),
    "THIN_PRISM_FISHEYE": Model(10, 2, 8, fisheye=True),
}
MODEL_NAMES = {model.number: name for name, model in MODELS.items()}


def model_parameters(name: str | None, given: str) -> int:
    """Return how many parameters the model `name` has; `given` is how the file spells it."""
    if name not in MODELS:
        known = ", ".join(f"{number} {name}" for number, name in sorted(MODEL_NAMES.items())[:2])
        text = f"the camera model is {shorten(given, 40)}; undistorted images have {known}"
        raise SceneError("CAMERA_DISTORTED", text)
    return MODELS[name].parameters


@dataclass(frozen=True)
class Lens:
    """One record of a cameras file, not yet checked: its id, a key of `MODELS`, size and parameters.

    `pointer` says where in the file it stands.
    """

    number: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]
    pointer: str

    def pinhole(self) -> tuple[int, int, float, float, float, float]:
        """Return width, height, fx, fy, cx, cy."""
        model = MODELS[self.model]
        distortion = self.parameters[model.focals + 2 :]
        if model.fisheye:
            text = f"the camera model is {self.model}, a fisheye lens; undistort the images"
            raise SceneError("CAMERA_DISTORTED", text)
        if any(value != 0 for value in distortion):
            shown = ", ".join(f"{value:g}" for value in distortion)
            text = f"the camera model is {self.model} with distortion {shown}; undistort the images"
            raise SceneError("CAMERA_DISTORTED", text)
        width, height = check_size((self.width, self.height))
        focals = (self.parameters[0], self.parameters[model.focals - 1])
        fx, fy = (check_pixels("the focal length", value, MIN_FOCAL) for value in focals)
        cx, cy = (check_pixels("the principal point", p) for p in self.parameters[model.focals :][:2])
        return width, height, fx, fy, cx, cy


@dataclass(frozen=True)
class Shot:
    """One record of an images file, not yet checked: its id, pose, camera's id, and name below the images.

    `quaternion` (w, x, y, z) and `translation` lead from world to camera; `pointer` says where in the file it
    stands.
    """

    number: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int
    name: bytes
    pointer: str
