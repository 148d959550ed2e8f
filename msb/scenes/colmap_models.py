"""COLMAP's camera models: the order of their parameters, and their pinhole parameters.

Names, ids and the order of parameters: `colmap/colmap`: src/colmap/sensor/models.h. The parameters of a model
are the focal lengths (one for both axes, or fx and fy), cx, cy, and the distortion coefficients.
"""

from dataclasses import dataclass
from typing import NamedTuple

from msb.errors import SceneError, shorten
from msb.scenes.checks import MIN_FOCAL, check_pixels, check_size
from msb.scenes.distortion import Distortion, make_distortion


class LensModel(NamedTuple):
    """A camera model of COLMAP: its id, and the number of focal lengths and distortion coefficients."""

    number: int
    focals: int
    distortions: int

    @property
    def parameters(self) -> int:
        """The number of parameters of a camera with this model."""
        return self.focals + 2 + self.distortions


MODELS = {
    "SIMPLE_PINHOLE": LensModel(0, 1, 0),
    "PINHOLE": LensModel(1, 2, 0),
    "SIMPLE_RADIAL": LensModel(2, 1, 1),
    "RADIAL": LensModel(3, 1, 2),
    "OPENCV": LensModel(4, 2, 4),
    "OPENCV_FISHEYE": LensModel(5, 2, 4),
    "FULL_OPENCV": LensModel(6, 2, 8),
    "FOV": LensModel(7, 2, 1),
    "SIMPLE_RADIAL_FISHEYE": LensModel(8, 1, 1),
    "RADIAL_FISHEYE": LensModel(9, 1, 2),
    "THIN_PRISM_FISHEYE": LensModel(10, 2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": LensModel(11, 2, 12),
    "SIMPLE_DIVISION": LensModel(12, 1, 1),
    "DIVISION": LensModel(13, 2, 1),
    "SIMPLE_FISHEYE": LensModel(14, 1, 0),
    "FISHEYE": LensModel(15, 2, 0),
    "EUCM": LensModel(16, 2, 2),
}
MODEL_NAMES = {model.number: name for name, model in MODELS.items()}


def model_parameters(name: str | None, given: str) -> int:
    """Return the number of parameters of the camera model `name`.

    `given` is the name in the file, which errors quote.
    """
    if name not in MODELS:
        text = (
            f"the camera model {shorten(given, 40)} is not a known lens (pinhole, radial, OpenCV, fisheye, "
            "FOV, division or EUCM); cut panoramas into perspective images"
        )
        raise SceneError("CAMERA_DISTORTED", text)
    return MODELS[name].parameters


@dataclass(frozen=True)
class Lens:
    """A camera record that was not checked: id, key of `MODELS`, size and parameters.

    `pointer` is the position of the record in the file.
    """

    number: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]
    pointer: str

    def intrinsics(self) -> tuple[int, int, float, float, float, float]:
        """Return width, height, fx, fy, cx, cy."""
        model = MODELS[self.model]
        width, height = check_size((self.width, self.height))
        focals = (self.parameters[0], self.parameters[model.focals - 1])
        fx, fy = (check_pixels("the focal length", value, MIN_FOCAL) for value in focals)
        cx, cy = (check_pixels("the principal point", p) for p in self.parameters[model.focals :][:2])
        return width, height, fx, fy, cx, cy

    def distortion(self) -> Distortion | None:
        """Return the lens distortion.

        If the camera is a pinhole camera or all coefficients are 0, return None.
        """
        return make_distortion(self.model, self.parameters[MODELS[self.model].focals + 2 :])


@dataclass(frozen=True)
class Shot:
    """One record of an images file, not yet checked: id, pose, camera id, and image name.

    `quaternion` (w, x, y, z) and `translation` transform from world to camera. `pointer` is the position of
    the record in the file.
    """

    number: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int
    name: bytes
    pointer: str
