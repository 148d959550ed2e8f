"""Build self-contained HTML pages: a common shell, the parts of a viewer, and the data of the viewer."""

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

# A placeholder in shell.html.
_MARK = re.compile(r"@([A-Z]+)@")


def build_page(package: str, meta: Mapping[str, Any], data: bytes = b"") -> bytes:
    """Return an HTML page as UTF-8. The page contains the files page.css, page.html and page.js of a package.

    `meta` is the JSON data of the script, and `data` is ASCII text without "<". Inserted text is not searched
    for placeholders, because a file name may look like a placeholder.
    """
    shell, viewer = files("msb_viewers"), files(package)
    # "</" in a file name would end the script element.
    text = json.dumps(meta, allow_nan=False).replace("<", "\\u003c")
    values = {
        "META": text.encode(),
        "DATA": data,
        "SCRIPT": (shell / "shell.js").read_bytes() + (viewer / "page.js").read_bytes(),
        "STYLE": (shell / "shell.css").read_bytes() + (viewer / "page.css").read_bytes(),
        "BODY": (viewer / "page.html").read_bytes(),
    }
    parts = _MARK.split((shell / "shell.html").read_text("utf-8"))
    return b"".join(values[part] if index % 2 else part.encode() for index, part in enumerate(parts))
