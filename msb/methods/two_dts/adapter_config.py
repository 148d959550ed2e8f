"""Read the config that a 2DTS training leaves beside a checkpoint: a YAML file, or a log that has one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from msb.adapters.training_config import missing, read_text, unusable
from msb.errors import CheckpointError, Finding, finding

MAX_DEPTH = 32
"""Deepest nesting of a config; real ones nest 3 deep."""
_LOG_HEAD = re.compile(r"config args:[ \t]*\n=+[^\n]*=+[ \t]*\n(.*?)^=+[ \t]*$", re.DOTALL | re.MULTILINE)
"""GaodeRender/triangle-splatting: the first record of the log is a YAML dump between two lines of "="."""


class _PlainLoader(yaml.SafeLoader):
    """A YAML loader without aliases: no config has them, and nested ones stand for exponentially many values.

    It also bounds the nesting, because the library calls itself for each level, and the length of integers.
    """

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent) or self._depth == MAX_DEPTH:
            raise yaml.YAMLError
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        made = super().construct_object(node, deep)
        if isinstance(made, int) and made.bit_length() > 63:
            raise OverflowError
        return made


def read_config(root: Path, given: Path | None) -> tuple[dict[str, Any], tuple[Path, ...], list[Finding]]:
    """Return the configuration of a 2DTS training, the files read, and warnings.

    It is looked for in this order: the file `given`, a YAML file in the output folder `root`, the latest text
    log in ``root/log``. The result has the file's own nesting, ``{"model": {...}, "trainer": {...}}``.
    """
    if given is not None:
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
    return {}, (), [*ignored, missing(root, text)]


def _config_of(path: Path) -> dict[str, Any]:
    """Return the configuration that a YAML file or a text log holds."""
    text = read_text(path)
    if path.suffix == ".log":
        match = _LOG_HEAD.search(text)
        if match is None:
            raise unusable(path, 'it has no "config args:" record')
        text = match[1]
    try:
        data = yaml.load(text, _PlainLoader)  # a SafeLoader: plain values only
    except ArithmeticError:
        raise unusable(path, "a number in it is too large") from None
    # What a value with a tag does not say ends in errors of Python's, such as KeyError for "!!bool maybe".
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        raise unusable(path, f"it is not valid YAML{where}") from None
    if not isinstance(data, dict) or not isinstance(data.get("model"), dict):
        raise unusable(path, 'it has no section "model"')
    return data
