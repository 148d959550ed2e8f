"""Read `cfg_args`, which trainers of the 3DGS family leave beside a checkpoint to say how it was trained.

Nothing in the file is evaluated; values are parsed as literals.
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
from msb.scenes.datasets.notes import saw_test_views

# Most bytes that are read. A config has some kilobytes, and a log starts with one; more would only cost
# time.
MAX_BYTES = 1 << 16


def read_cfg_args(root: Path) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the values in `cfg_args` of the output folder `root`, the files read, and warnings.

    `cfg_args` is one line, ``Namespace(sh_degree=3, white_background=False, ...)``: Python call syntax with
    literal values (trianglesplatting/triangle-splatting: train.py).
    """
    path = root / "cfg_args"
    if not path.is_file():
        text = "cfg_args is not there, so the background used in training is not known; where something is "
        text += "drawn, --background COLOR gives it"
        return {}, (), [missing(root, text)]
    try:
        text = read_text(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about escapes in literals: the file's business
            call = ast.parse(text.strip(), mode="eval").body
        if not isinstance(call, ast.Call) or call.args or getattr(call.func, "id", "") != "Namespace":
            raise ValueError
        values = {word.arg: ast.literal_eval(word.value) for word in call.keywords if word.arg}
        if len(values) != len(call.keywords):  # **mapping, or a name twice
            raise ValueError
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
        text = "cfg_args is not one line Namespace(name=value, ...); it was ignored"
        return {}, (), [finding("CHECKPOINT_CONFIG", text, severity="warning", pointer="cfg_args")]
    return values, (path,), [saw_test_views()] if values.get("eval") is False else []


def training_of(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the values of `cfg_args` say for the manifest's key `training`: no path of a machine."""
    training: dict[str, Any] = {}
    if isinstance(held_back := arguments.get("eval"), bool):
        training["eval"] = held_back
    if isinstance(folder := arguments.get("images"), str) and folder.isprintable():
        training["images"] = re.split(r"[/\\]", folder.rstrip("/\\"))[-1][:200]
    if type(resolution := arguments.get("resolution")) is int and abs(resolution) < 1 << 31:
        training["resolution"] = resolution
    return training


def named_up(path: Any) -> str:
    """Return what is up in the dataset that `path` names: +z in NeRF-Synthetic, -y in those from COLMAP.

    "unknown" if it names none. The path is that of the machine that trained: it is not looked at.
    """
    names = str(path).lower()
    for up, words in (("+z", ("synthetic", "blender")), ("-y", ("colmap", "360", "tanks", "tandt", "dtu"))):
        if any(word in names for word in words):
            return up
    return "unknown"


def trained_up(arguments: Mapping[str, Any]) -> str:
    """Return what is up in a training with these `cfg_args`: its scene is from COLMAP or NeRF-Synthetic."""
    path = arguments.get("source_path")
    if not isinstance(path, str) or named_up(path) != "unknown":
        return named_up(path)
    scene = re.split(r"[/\\]", path.rstrip("/\\"))[-1]
    objects = DATASETS["nerf_synthetic"].scenes
    return "+z" if scene in objects and arguments.get("white_background") is True else "-y"


def read_text(path: Path) -> str:
    """Return the beginning of a text file; errors as `unusable`."""
    try:
        return read_file(path, MAX_BYTES)[:MAX_BYTES].decode("utf-8", "replace").replace("\r\n", "\n")
    except InputError as error:
        raise unusable(path, error.message) from error


def unusable(path: Path, why: str) -> CheckpointError:
    """Return the error `CHECKPOINT_CONFIG`."""
    return CheckpointError("CHECKPOINT_CONFIG", shorten(why, 200), file=path)


def missing(root: Path, text: str) -> Finding:
    """Return the warning that a config of the output folder `root` is not there."""
    return finding("CHECKPOINT_CONFIG_MISSING", text, severity="warning", file=str(root))
