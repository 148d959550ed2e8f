"""Pages of one file that load nothing: the shell of both viewers, a viewer's own parts, and its data."""

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

_MARK = re.compile(r"@([A-Z]+)@")


def filled(package: str, meta: Mapping[str, Any], data: bytes = b"") -> bytes:
    """Return a page, UTF-8, with the style, body and script that lie in a package as page.css, .html and .js.

    `meta` is what the script reads under that name; `data` is ASCII without "<". What replaces a mark of the
    shell is not searched again, because a file name may look like a mark.
    """
    shell, own = files("msb_viewers"), files(package)
    # "</" would end the element it stands in, whatever a file is called.
    text = json.dumps(meta, allow_nan=False).replace("<", "\\u003c")
    values = {
        "META": text.encode(),
        "DATA": data,
        "SCRIPT": (shell / "shell.js").read_bytes() + (own / "page.js").read_bytes(),
        "STYLE": (shell / "shell.css").read_bytes() + (own / "page.css").read_bytes(),
        "BODY": (own / "page.html").read_bytes(),
    }
    parts = _MARK.split((shell / "shell.html").read_text("utf-8"))
    return b"".join(values[part] if index % 2 else part.encode() for index, part in enumerate(parts))
