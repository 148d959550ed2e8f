"""Sets of cameras: their validation, and the split into training and test views."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from msb.base.paths import normal_form
from msb.errors import UsageError, shorten
from msb.scenes.camera import Camera
from msb.scenes.source import Source

# Every 8th view is a test view: `llffhold` of `graphdeco-inria/gaussian-splatting`.
HOLD = 8


def check_cameras(cameras: Iterable[Camera]) -> list[Camera]:
    """Return the cameras that a caller passed as a list. Any other argument is a usage error."""
    listed = list(cameras) if isinstance(cameras, Iterable) else None
    if listed is None or not all(isinstance(camera, Camera) for camera in listed):
        text = f"cameras is {shorten(repr(cameras), 40)}; it must be a sequence of msb.Camera"
        raise UsageError("USAGE", text)
    return listed


def check_set(cameras: Sequence[Camera], source: Source) -> None:
    """Raise an error for an empty set, or for two cameras with equal names."""
    if not cameras:
        raise source.error("CAMERA_NONE", "it contains no camera; at least one is needed")
    seen: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        if camera.name is None:
            continue
        name = normal_form(camera.name)
        if name in seen:
            text = f"cameras {seen[name]} and {index} have the same name '{shorten(camera.name)}'"
            raise source.error("CAMERA_FILE", text)
        seen[name] = index


def stem(camera: Camera) -> str:
    """Return the camera's name without folders, up to its first dot (`image_name` in the 3DGS family).

    For example, "a/img.b.png" gives "img". Several cameras can have the same stem, so only full names
    identify a camera. A camera without a name has the stem "".
    """
    return (camera.name or "").rsplit("/", 1)[-1].split(".", 1)[0]


def sorted_by_stem(cameras: Iterable[Camera]) -> list[Camera]:
    """Return the cameras in the order of the 3DGS family.

    Cameras are sorted by the code points of `stem`: "DSC_10" comes before "DSC_2", and upper case comes
    first. Cameras with equal stems keep their order.

    Source: `graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py.
    """
    return sorted(cameras, key=stem)


def split_every_8th(
    cameras: Iterable[Camera], key: Callable[[Camera], str] = stem
) -> tuple[list[Camera], list[Camera]]:
    """Return (train, test). When the cameras are sorted by `key`, cameras 0, 8, 16, ... are test views.

    The `split` of each returned camera is set. Use this function for captures without a predefined split.

    Source: `graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py (`llffhold`).
    """
    ordered = sorted(cameras, key=key)
    train = [replace(camera, split="train") for index, camera in enumerate(ordered) if index % HOLD]
    return train, [replace(camera, split="test") for camera in ordered[::HOLD]]
