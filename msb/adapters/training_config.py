"""Read `cfg_args`, the file with the options of a training of the 3DGS family.

Values are parsed as Python literals. Reading the file executes nothing in it.
"""

import ast
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msb.base.files import read_file
from msb.errors import CheckpointError, Finding, InputError, finding, shorten
from msb.scenes.datasets.catalog import DATASETS
from msb.scenes.datasets.notes import warn_test_views

# Maximum number of bytes read from a config or log. A config has some kilobytes, and a log begins with its
# config.
MAX_BYTES = 1 << 16
_NAMESPACE = re.compile(r"Namespace\((.*)\)", re.DOTALL)
# Matches a quoted text, a bracket or a comma.
_TOKEN = re.compile(r"""'(?:[^'\\]|\\.)*+'|"(?:[^"\\]|\\.)*+"|[(\[{)\]},]""", re.DOTALL)


def read_cfg_args(root: Path) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the values in `cfg_args` of the output folder `root`, the files that were read, and warnings.

    `cfg_args` is one line, ``Namespace(sh_degree=3, white_background=False, ...)``, a Python call with
    literal values (trianglesplatting/triangle-splatting: train.py).
    """
    path = root / "cfg_args"
    if not path.is_file():
        text = (
            "cfg_args is missing, so the background of the training is unknown; pass --background COLOR to "
        )
        text += "commands that draw"
        return {}, (), [missing(root, text)]
    try:
        inside = _NAMESPACE.fullmatch(read_text(path).strip())
    except CheckpointError as error:
        return {}, (), [finding(error.code, error.message, severity="warning", pointer="cfg_args")]
    values, unread = _parse_arguments(inside[1]) if inside else ({}, [])
    if inside is None or (unread and not values):
        text = "cfg_args is not a line Namespace(name=value, ...); the file is ignored"
        return {}, (), [finding("CHECKPOINT_CONFIG", text, severity="warning", pointer="cfg_args")]
    found = [warn_test_views()] if values.get("eval") is False else []
    if unread:
        text = f"cfg_args has values that are not literals, which are ignored: {', '.join(unread[:8])}"
        found.append(finding("CHECKPOINT_CONFIG", text, severity="warning", pointer="cfg_args"))
    return values, (path,), found


def _parse_arguments(text: str) -> tuple[dict[str, Any], list[str]]:
    """Return the values of ``name=value, ...``, and the names whose value is not a literal.

    If a name occurs twice, the second value is ignored.
    """
    values: dict[str, Any] = {}
    unread: list[str] = []
    for part in _split_arguments(text):
        name, _, value = part.partition("=")
        name = name.strip()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # hide Python's warnings about escapes in literals
                read = ast.literal_eval(value.strip())
            if not name.isidentifier() or name in values or name in unread:
                raise ValueError
        except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
            values.pop(name, None)
            unread.append(shorten(name, 40))
        else:
            values[name] = read
    return values, unread


def _split_arguments(text: str) -> list[str]:
    """Split `text` at commas outside quotes and brackets."""
    parts, start, depth = [], 0, 0
    for token in _TOKEN.finditer(text):
        if token[0] in "([{":
            depth += 1
        elif token[0] in ")]}":
            depth -= 1
        elif token[0] == "," and depth <= 0:
            parts.append(text[start : token.start()])
            start = token.end()
    parts.append(text[start:])
    return [part for part in parts if part.strip()]


def training_of(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values for the key `training` of the manifest.

    The values must not contain paths of the training machine.
    """
    training: dict[str, Any] = {}
    if isinstance(held_out := arguments.get("eval"), bool):
        training["eval"] = held_out
    if isinstance(folder := arguments.get("images"), str) and folder.isprintable():
        training["images"] = re.split(r"[/\\]", folder.rstrip("/\\"))[-1][:200]
    if type(resolution := arguments.get("resolution")) is int and abs(resolution) < 1 << 31:
        training["resolution"] = resolution
    return training


def named_up(path: Any) -> str:
    """Return the up axis of the dataset in which `path` lies: +z for NeRF-Synthetic, -y for COLMAP datasets.

    The result is "unknown" for other datasets. The path belongs to the training machine and is not opened.
    """
    names = str(path).lower()
    for up, words in (("+z", ("synthetic", "blender")), ("-y", ("colmap", "360", "tanks", "tandt", "dtu"))):
        if any(word in names for word in words):
            return up
    return "unknown"


def trained_up(arguments: Mapping[str, Any]) -> str:
    """Return the up axis of a training with these `cfg_args`.

    The scene is assumed to be from NeRF-Synthetic or COLMAP.
    """
    path = arguments.get("source_path")
    if not isinstance(path, str) or named_up(path) != "unknown":
        return named_up(path)
    scene = re.split(r"[/\\]", path.rstrip("/\\"))[-1]
    objects = DATASETS["nerf_synthetic"].scenes
    return "+z" if scene in objects and arguments.get("white_background") is True else "-y"


def read_text(path: Path) -> str:
    """Return the first `MAX_BYTES` of a text file. If the file cannot be read, raise the error that
    `unusable` returns."""
    try:
        return read_file(path, MAX_BYTES)[:MAX_BYTES].decode("utf-8", "replace").replace("\r\n", "\n")
    except InputError as error:
        raise unusable(path, error.message) from error


def unusable(path: Path, why: str) -> CheckpointError:
    """Return the error CHECKPOINT_CONFIG for a file that cannot be used."""
    return CheckpointError("CHECKPOINT_CONFIG", shorten(why, 200), file=path)


def missing(root: Path, text: str) -> Finding:
    """Return the warning that the config in the output folder `root` is missing."""
    return finding("CHECKPOINT_CONFIG_MISSING", text, severity="warning", file=str(root))
