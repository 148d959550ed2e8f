"""What other programs see in a GLB: its positions and its JSON, without the frame that msb takes back."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON of a GLB."""
    data = path.read_bytes()
    (size,) = struct.unpack("<I", data[12:16])
    document: dict[str, Any] = json.loads(data[20 : 20 + size])
    return document


def read_positions(path: Path) -> Any:
    """Return the positions (V, 3) of the first primitive of a GLB as stored."""
    data, root = path.read_bytes(), read_json(path)
    accessor = root["accessors"][root["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    view = root["bufferViews"][accessor["bufferView"]]
    start = 28 + struct.unpack("<I", data[12:16])[0] + view.get("byteOffset", 0)
    return np.frombuffer(data, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
