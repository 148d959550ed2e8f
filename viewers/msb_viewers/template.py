"""Pages of one file: a template, its data as JSON, and its script. A page loads nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

_MARK = re.compile(r"@([A-Z]+)@")


def filled(template: str, script: str, meta: Mapping[str, Any], data: bytes = b"") -> bytes:
    """Return a page, UTF-8.

    Parameters
    ----------
    template, script : str
        Files of this package. In the template @META@, @DATA@, @SCRIPT@ and @STYLE@ are replaced. The text
        in their place is not searched again, because a file name may look like a mark.
    meta : mapping
        What the script reads as `meta`.
    data : bytes
        ASCII without "<".
    """
    # "</" would end the element it stands in, whatever a file is called.
    text = json.dumps(meta, allow_nan=False).replace("<", "\\u003c")
    values = {
        "META": text.encode(),
        "DATA": data,
        "SCRIPT": (_text("common.js") + _text(script)).encode(),
        "STYLE": _text("common.css").encode(),
    }
    parts = _MARK.split(_text(template))
    return b"".join(values[part] if index % 2 else part.encode() for index, part in enumerate(parts))


def _text(name: str) -> str:
    place = files("msb_viewers")
    for part in name.split("/"):
        place = place / part
    return place.read_text("utf-8")
