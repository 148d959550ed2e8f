"""SHA-256 of files and folders, and short hashes of the inputs of a result."""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from msb.base.files import file_sha256
from msb.bench.records import File

# Number of hexadecimal digits of a short hash. 16 digits are 64 bits, which is enough to detect a changed
# input.
_SHORT_DIGITS = 16


def digest(data: Any) -> str:
    """Return a short hash (16 hexadecimal digits) of JSON data."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_SHORT_DIGITS]


def list_sha256(hashes: Iterable[tuple[str, str]]) -> str:
    """Return the SHA-256 of a file list in the format of ``sha256sum``, sorted by name."""
    lines = "".join(f"{sha256}  {name}\n" for name, sha256 in sorted(hashes))
    return hashlib.sha256(lines.encode()).hexdigest()


def describe_file(path: Path) -> File:
    """Return path, size and hash of a file. For a folder, the visible files are included."""
    if not path.is_dir():
        sha256 = file_sha256(path)
        return File(path=str(path), bytes=path.stat().st_size, sha256=sha256)
    files = sorted(
        Path(root, name) for root, _, names in os.walk(path) for name in names if not name.startswith(".")
    )
    hashes = [(file.relative_to(path).as_posix(), file_sha256(file)) for file in files]
    size = sum(file.stat().st_size for file in files)
    return File(path=str(path), bytes=size, sha256=list_sha256(hashes))


def stamp(path: Path) -> tuple[str, int, int]:
    """Return path, size in bytes and modification time in ns, to detect changes without reading the file."""
    status = path.stat()
    return str(path), status.st_size, status.st_mtime_ns
