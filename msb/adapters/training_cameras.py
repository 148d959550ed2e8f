"""The cameras that a model was trained with: those beside it, or those of the scene its config names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msb.adapters.locate import locate
from msb.adapters.training_config import read_cfg_args
from msb.asset import is_asset
from msb.errors import MsbError
from msb.registry import role
from msb.scenes import Camera, read_cameras

# What official code of the 3DGS family writes into the output folder (graphdeco-inria/gaussian-splatting:
# scene/__init__.py), and a run beside the assets it makes.
CAMERAS = "cameras.json"
# Folders at the end of the name that a config gives, with which the scene is looked for elsewhere.
_DEEPEST = 40
# Folders above a model from which the scene is looked for, if it is not where the config says.
_LEVELS = 6


def training_cameras(path: Path, method: str) -> Iterator[tuple[list[Camera], Path]]:
    """Yield the cameras of the training of the model at `path`, and where they are from; the surest first."""
    try:
        root = path.absolute().parent if is_asset(path) else locate(path).root.absolute()
        places = [root / CAMERAS] if (root / CAMERAS).is_file() else []
        if (scene := _scene(root, method)) is not None:
            places.append(scene)
    except (MsbError, OSError, ValueError):  # a mesh file, a name that no path can have
        return
    for place in places:
        try:
            yield read_cameras(place), place
        except MsbError:  # a scene of images alone, a file of something else
            continue


def _scene(root: Path, method: str) -> Path | None:
    """Return the scene that the config in `root` names: there, or where it was moved to."""
    own: Any = role(method, "adapter")
    if hasattr(own, "training_scene"):
        named = own.training_scene(root)
    else:
        named = read_cfg_args(root)[0].get("source_path")
    if not isinstance(named, str) or not named:
        return None
    parts = Path(named.replace("\\", "/")).parts
    ends = (Path(*parts[k:]) for k in range(max(0, len(parts) - _DEEPEST), len(parts) - 1))
    moved = (above / end for end in ends for above in (root, *root.parents[:_LEVELS]))
    return next((place for place in (Path(named), *moved) if place.is_dir()), None)
