"""The demo's data: stub scenes and models, which a wheel carries along and a checkout has in `data_stubs`."""

import os
import shutil
from pathlib import Path

from msb.base.own_folder import own_folder

# The data in `data_stubs`, beside the scripts that make it; pyproject.toml puts the same into a wheel.
CONTENTS = (
    "checkpoint",
    "models",
    "protocol.toml",
    "protocol_all.toml",
    "scenes",
    "splat_like.triasset",
    "views.json",
)
PROTOCOL, RESULTS = "protocol.toml", "results"
_IN_WHEEL = Path(__file__).parents[1] / "demo_data"
_IN_CHECKOUT = Path(__file__).parents[2] / "data_stubs"


def demo_folder() -> Path:
    """Return the folder that holds the demo's data."""
    return _IN_WHEEL if _IN_WHEEL.is_dir() else _IN_CHECKOUT


def write_demo(folder: str | os.PathLike[str], *, overwrite: bool = True) -> int:
    """Write the demo's data as `folder`, and return its size in bytes.

    With `overwrite` it replaces demo data that an earlier call wrote; other files stay.
    """
    source = demo_folder()
    paths = [path for name in CONTENTS for path in (source / name, *(source / name).rglob("*"))]
    with own_folder(folder, overwrite=overwrite) as target:
        for path in sorted(paths):
            place = target / path.relative_to(source)
            if path.is_dir():
                place.mkdir()
            else:
                shutil.copyfile(path, place)  # without its mode: an installation may be read-only
    return sum(path.stat().st_size for path in paths if path.is_file())
