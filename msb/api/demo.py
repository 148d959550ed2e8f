"""The demo data: small scenes and models, which are part of each wheel and checkout (`data_stubs`)."""

import os
import shutil
from pathlib import Path

from msb.base.own_folder import own_folder

# The data in `data_stubs`, without the scripts that create the data. A list in pyproject.toml contains the
# same files for wheels.
CONTENTS = (
    "checkpoint",
    "models",
    "protocol.toml",
    "protocol_all.toml",
    "published.json",
    "scenes",
    "splat_like.triasset",
    "views.json",
)
PROTOCOL, RESULTS = "protocol.toml", "results"
_IN_WHEEL = Path(__file__).parents[1] / "demo_data"
_IN_CHECKOUT = Path(__file__).parents[2] / "data_stubs"


def demo_folder() -> Path:
    """Return the folder of the demo data."""
    return _IN_WHEEL if _IN_WHEEL.is_dir() else _IN_CHECKOUT


def write_demo(folder: str | os.PathLike[str], *, overwrite: bool = True) -> int:
    """Write the demo data to `folder`, and return its size in bytes.

    With `overwrite`, demo data of an earlier call is replaced, and other files are kept.
    """
    source = demo_folder()
    paths = [path for name in CONTENTS for path in (source / name, *(source / name).rglob("*"))]
    with own_folder(folder, overwrite=overwrite) as target:
        for path in sorted(paths):
            place = target / path.relative_to(source)
            if path.is_dir():
                place.mkdir()
            else:
                # Do not copy the file mode, because the files of an installation may be read-only.
                shutil.copyfile(path, place)
    return sum(path.stat().st_size for path in paths if path.is_file())
