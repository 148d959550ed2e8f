"""What the official trainers leave beside a checkpoint about how it was trained: cfg_args, YAML, text log.

Nothing here is evaluated: `cfg_args` is parsed as literals, YAML with the safe loader.
"""

from __future__ import annotations

import ast
import re
import warnings
from typing import TYPE_CHECKING, Any

import yaml

from msb.errors import CheckpointError, Finding, InputError, finding, shorten

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES = 1 << 16
"""Configs have some kilobytes, and a log starts with one; the limit bounds the work on anything else."""
MAX_DEPTH = 32
"""Configs nest 3 deep."""
_LOG_HEAD = re.compile(r"config args:[ \t]*\n=+[^\n]*=+[ \t]*\n(.*?)^=+[ \t]*$", re.DOTALL | re.MULTILINE)
"""GaodeRender/triangle-splatting: the first record of the log is a YAML dump between two lines of "="."""


class _PlainLoader(yaml.SafeLoader):
    """Without aliases: no config has them, and nested ones stand for exponentially many values.

    And not nested deeper than any config: the library calls itself for each level.
    """

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent) or self._depth == MAX_DEPTH:
            raise yaml.YAMLError
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def read_cfg_args(root: Path) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the values in `cfg_args` of the output folder `root`, the files read, and warnings.

    `cfg_args` is one line, ``Namespace(sh_degree=3, white_background=False, ...)``: Python call syntax with
    literal values (trianglesplatting/triangle-splatting: train.py).
    """
    path = root / "cfg_args"
    if not path.is_file():
        return {}, (), [_missing(root, "cfg_args is not there: the background used in training is not known")]
    try:
        text = _read_text(path)
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
        return {}, (), [finding("CHECKPOINT_CONFIG_FILE", text, severity="warning", pointer="cfg_args")]
    return values, (path,), []


def read_two_dts_config(
    root: Path, given: Path | None
) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the configuration of a 2DTS training, the files read, and warnings.

    Looked for in this order: the file `given`, a YAML file in the output folder `root`, the latest text log
    in ``root/log``. What it holds is the file's own nesting, ``{"model": {...}, "trainer": {...}}``.

    Raises
    ------
    CheckpointError
        `CHECKPOINT_CONFIG_FILE`, for a file that was given.
    InputError
        `FILE_NOT_FOUND`, for a file that was given.
    """
    if given is not None:
        if not given.is_file():
            raise InputError("FILE_NOT_FOUND", "there is no such file", file=given)
        return _config_of(given), (given,), []
    ignored: list[Finding] = []
    logs = sorted((root / "log").glob("*_outputs.log"), reverse=True) or sorted((root / "log").glob("*.log"))
    for path in (*sorted(root.glob("*.y*ml")), *logs):
        try:
            return _config_of(path), (path,), ignored
        except CheckpointError as error:
            text = f"{path.relative_to(root)}: {error.message}; it was ignored"
            ignored.append(finding(error.code, text, severity="warning", pointer=path.name))
    text = "there is no YAML config and no log with one, so rasterizer and other settings are defaults"
    return {}, (), [*ignored, _missing(root, text)]


def _config_of(path: Path) -> dict[str, Any]:
    """Return the configuration that a YAML file or a text log holds.

    Raises
    ------
    CheckpointError
        `CHECKPOINT_CONFIG_FILE`.
    """
    text = _read_text(path)
    if path.suffix == ".log":
        match = _LOG_HEAD.search(text)
        if match is None:
            raise _unusable(path, 'it has no "config args:" record')
        text = match[1]
    try:
        data = yaml.load(text, _PlainLoader)  # a SafeLoader: plain values only
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        raise _unusable(path, f"it is not valid YAML{where}") from None
    if not isinstance(data, dict) or not isinstance(data.get("model"), dict):
        raise _unusable(path, 'it has no section "model"')
    return data


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES).decode("utf-8", "replace").replace("\r\n", "\n")
    except OSError as error:
        raise _unusable(path, f"it cannot be read: {error.strerror}") from error


def _unusable(path: Path, why: str) -> CheckpointError:
    return CheckpointError("CHECKPOINT_CONFIG_FILE", shorten(why, 200), file=path)


def _missing(root: Path, text: str) -> Finding:
    return finding("CHECKPOINT_CONFIG_MISSING", text, severity="warning", file=str(root))
