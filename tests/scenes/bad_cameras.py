"""Cameras that must be refused: name -> files, the path to read and the code."""

from pathlib import Path
from typing import Any

from msb.scenes import read_cameras, read_points

from .bad_colmap import BAD_COLMAP, BAD_POINTS, BAD_TEXT, SHOTS
from .bad_json import BAD_JSON, CAMERAS, bare
from .builders import (
    Bad,
    Files,
    cameras_json,
    colmap_txt,
    dump,
    jpeg,
    lens_bin,
    many,
    point_bin,
    views,
    write,
)

BAD: dict[str, Bad] = {
    f"{group}: {name}": bad
    for group, table in (
        ("colmap", BAD_COLMAP),
        ("text", BAD_TEXT),
        ("points", BAD_POINTS),
        ("json", BAD_JSON),
    )
    for name, bad in table.items()
}
"""All of them. Those of the group "points" are read by `read_points`, the others by `read_cameras`."""


def read_case(name: str, root: Path) -> Any:
    """Write one of them below `root`, and read it."""
    files, target, _ = BAD[name]
    read = read_points if name.startswith("points") else read_cameras
    return read(write(root, files) / target)


SMALL: dict[str, Files] = {
    "binary": {"cameras.bin": many(lens_bin(), lens_bin(2, 0, parameters=(5, 2, 1))), "images.bin": SHOTS},
    "text": colmap_txt(CAMERAS),
    "points3D.bin": {"points3D.bin": many(point_bin(), point_bin(track=2))},
    "points3D.txt": {"points3D.txt": b"# p\n1 2 3 4 5 6 7 8 9 10\n2 0.5 -1 1e3 0 255 9 0.1\n"},
    "transforms.json": {"transforms.json": dump(bare("a.jpg")), "a.jpg": jpeg(5, 4)},
    "cameras.json": {"cameras.json": dump(cameras_json(CAMERAS[:1]))},
    "views.json": {"views.json": dump(views(CAMERAS[:1], background=[0, 0.5, 1]))},
}
"""Good files to be cut and changed, one kind of source each."""
