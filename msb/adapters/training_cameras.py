"""Find the cameras of a training in its output folder, or in the scene that its config names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msb.adapters.locate import locate
from msb.adapters.training_config import read_cfg_args
from msb.asset import is_asset
from msb.errors import MsbError
from msb.registry import role
from msb.scenes import Camera, read_cameras

# The camera file that 3DGS code writes into the output folder (graphdeco-inria/gaussian-splatting:
# scene/__init__.py). File that `msb run` writes next to its assets.
CAMERAS = "cameras.json"
# Maximum number of last components of the scene's path that are used to find a moved scene.
_DEEPEST = 40
# Number of folders above a model that are searched for a moved scene.
_LEVELS = 6


def training_cameras(path: Path, method: str) -> Iterator[tuple[list[Camera], Path]]:
    """Yield the training cameras of the model at `path` with their source. The most reliable cameras come
    first."""
    try:
        root = path.absolute().parent if is_asset(path) else locate(path).root.absolute()
        places = [root / CAMERAS] if (root / CAMERAS).is_file() else []
        if (scene := _scene(root, method)) is not None:
            places.append(scene)
    except (MsbError, OSError, ValueError):  # `path` is a mesh file, or not a valid path
        return
    for place in places:
        try:
            yield read_cameras(place), place
        except MsbError:  # for example a scene without cameras
            continue


def _scene(root: Path, method: str) -> Path | None:
    """Return the scene that the config in `root` names, even if scene and model were moved together."""
    adapter: Any = role(method, "adapter")
    if hasattr(adapter, "training_scene"):
        named = adapter.training_scene(root)
    else:
        named = read_cfg_args(root)[0].get("source_path")
    if not isinstance(named, str) or not named:
        return None
    # If the path does not exist, search for its last components below the folders above the model.
    parts = Path(named.replace("\\", "/")).parts
    ends = (Path(*parts[k:]) for k in range(max(0, len(parts) - _DEEPEST), len(parts) - 1))
    moved = (above / end for end in ends for above in (root, *root.parents[:_LEVELS]))
    return next((place for place in (Path(named), *moved) if place.is_dir()), None)
