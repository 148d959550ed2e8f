"""Sets of cameras: what every set must fulfil, and the split into training and test views."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from msb.base.paths import normal_form
from msb.errors import UsageError, shorten
from msb.scenes.camera import Camera
from msb.scenes.source import Source

# Every HOLD-th view is a test view: `llffhold` of `graphdeco-inria/gaussian-splatting`.
HOLD = 8


def given_cameras(cameras: Iterable[Camera]) -> list[Camera]:
    """Return the cameras of a caller."""
    listed = list(cameras) if isinstance(cameras, Iterable) else None
    if listed is None or not all(isinstance(camera, Camera) for camera in listed):
        raise UsageError("USAGE", f"cameras is {shorten(repr(cameras), 40)}; it must be several msb.Camera")
    return listed


def check_set(cameras: Sequence[Camera], source: Source) -> None:
    """Check that there are cameras and that no two have the same name."""
    if not cameras:
        raise source.error("CAMERA_NONE", "there is no camera in it; it must hold at least one")
    seen: dict[str, int] = {}
    for index, camera in enumerate(cameras):
        if camera.name is None:
            continue
        name = normal_form(camera.name)
        if name in seen:
            text = f"cameras {seen[name]} and {index} are both called '{shorten(camera.name)}'"
            raise source.error("CAMERA_FILE", text)
        seen[name] = index


def stem(camera: Camera) -> str:
    """Return the name without folders, up to its first dot: `image_name` of the 3DGS family.

    "a/img.b.png" gives "img", so stems may repeat; only names identify a camera. A camera without a name
    gives "".
    """
    return (camera.name or "").rsplit("/", 1)[-1].split(".", 1)[0]


def sorted_by_stem(cameras: Iterable[Camera]) -> list[Camera]:
    """Return the cameras in the order in which the 3DGS family numbers them.

    They are sorted by `stem` and code point ("DSC_10" before "DSC_2", upper case first); equal stems keep
    their order.

    Source: `graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py.
    """
    return sorted(cameras, key=stem)


def split_every_8th(
    cameras: Iterable[Camera], key: Callable[[Camera], str] = stem
) -> tuple[list[Camera], list[Camera]]:
    """Return (train, test): of the cameras sorted by `key` number 0, 8, 16, ... are for testing.

    The `split` of each camera returned says which it is. This is for captures without a split of their own,
    so a `split` already there is replaced.

    Source: `graphdeco-inria/gaussian-splatting`: scene/dataset_readers.py (`llffhold`).
    """
    ordered = sorted(cameras, key=key)
    train = [replace(camera, split="train") for index, camera in enumerate(ordered) if index % HOLD]
    return train, [replace(camera, split="test") for camera in ordered[::HOLD]]
