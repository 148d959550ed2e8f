"""Read and write views.json, the package's camera file format. The file stores all fields except paths."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, cast

from msb.base.atomic import new_file
from msb.base.paths import given_path
from msb.errors import OutputError, SceneError
from msb.scenes.camera import Camera
from msb.scenes.checks import Split
from msb.scenes.colors import unit_color
from msb.scenes.json_node import MAX_BYTES, Node, read_json
from msb.scenes.sets import check_cameras, check_set
from msb.scenes.source import Source

SCHEMA = "msb.views/1"
_REQUIRED = ("width", "height", "fx", "fy", "cx", "cy", "world_to_camera")
_OPTIONAL = ("name", "source_size", "split")


class ViewsFile(NamedTuple):
    """The content of a views.json: cameras, and the background of renderings in the stored colour space."""

    cameras: list[Camera]
    background: tuple[float, float, float] | None = None


def read_views(path: str | os.PathLike[str]) -> ViewsFile:
    """Read a views.json."""
    source = Source.open(Path(path))
    views = read(read_json(source))
    check_set(views.cameras, source)
    return views


def read(root: Node) -> ViewsFile:
    """Return the content of a document. Unknown keys are errors, so that misspelt keys are noticed."""
    schema = root["schema"]
    if schema.value != SCHEMA:
        raise schema.error("CAMERA_FILE", f'it is {schema.abbreviated()}; it must be "{SCHEMA}"')
    root.only("schema", "background", "cameras")
    background = root.get("background")
    cameras = [_camera(node) for node in root["cameras"].items()]
    return ViewsFile(cameras, None if background is None else _color(background))


def _color(node: Node) -> tuple[float, float, float]:
    """Return a colour of three numbers from 0 to 1."""
    color = unit_color(node.array(3))
    if color is None:
        raise node.error(
            "CAMERA_FILE", f"it is {node.abbreviated()}; red, green and blue must be from 0 to 1"
        )
    return color


def _camera(node: Node) -> Camera:
    """Return the camera of one entry."""
    name, size, split, unit = map(node.get, (*_OPTIONAL, "unit"))
    node.only(*_OPTIONAL[:1], *_REQUIRED, *_OPTIONAL[1:], "unit")
    with node.locating():
        return Camera(
            node["width"].whole(),
            node["height"].whole(),
            node["fx"].number(),
            node["fy"].number(),
            node["cx"].number(),
            node["cy"].number(),
            node["world_to_camera"].array(4, 4),
            None if name is None else name.text(),
            None,
            None if size is None else cast("tuple[int, int]", [n.whole() for n in size.items()]),
            None if split is None else cast("Split", split.text()),
            1.0 if unit is None else unit.number(),
        )


def write_cameras(
    cameras: Iterable[Camera],
    path: str | os.PathLike[str],
    *,
    background: tuple[float, float, float] | None = None,
) -> None:
    """Write a views.json with one camera per line.

    `read_cameras` returns equal cameras, except for `image_path`, which is not stored.

    Parameters
    ----------
    cameras : iterable of Camera
        At least one camera. Names must be unique; cameras without a name are allowed.
    path : str or Path
        The file. The file is replaced completely. If writing fails, it is not changed.
    background : (float, float, float), optional
        Red, green and blue in [0, 1].

    Raises
    ------
    SceneError
        CAMERA_NONE or CAMERA_FILE.
    OutputError
        OUTPUT_UNWRITABLE, or OUTPUT_FORMAT_LIMIT: the file would be too large for `read_cameras`.
    UsageError
        USAGE: `cameras` or `path` has the wrong type, for example because they were swapped.
    """
    cameras, path = check_cameras(cameras), given_path(path)
    check_set(cameras, Source(path, b""))
    head: dict[str, Any] = {"schema": SCHEMA}
    if background is not None:
        head["background"] = [float(value) for value in background]
        if len(head["background"]) != 3 or not all(0 <= value <= 1 for value in head["background"]):
            text = f"the background is {background}; it must be red, green and blue from 0 to 1"
            raise SceneError("CAMERA_FILE", text, file=path)
    # Write one camera per line, so that files can be compared and edited by hand.
    lines = ",\n  ".join(json.dumps(_entry(camera)) for camera in cameras)
    content = f'{json.dumps(head)[:-1]}, "cameras": [\n  {lines}\n]}}\n'.encode("ascii")
    if len(content) > MAX_BYTES:
        text = f"{len(cameras)} cameras need {len(content)} bytes; a views.json is limited to {MAX_BYTES}"
        raise OutputError("OUTPUT_FORMAT_LIMIT", text, file=path)
    with new_file(path) as stream:
        stream.write(content)


def _entry(camera: Camera) -> dict[str, Any]:
    """Return the camera as JSON data.

    When the written numbers are read again, the values are exactly the same.
    """
    entry = {"name": camera.name} | {key: getattr(camera, key) for key in _REQUIRED}
    entry |= {key: getattr(camera, key) for key in _OPTIONAL[1:]}
    entry["world_to_camera"] = camera.world_to_camera.tolist()
    entry |= {"unit": camera.unit} if camera.unit != 1 else {}
    return {key: value for key, value in entry.items() if value is not None}
