"""Bad images, evaluation data and weights by name, with their fuzz target, content, and error code."""

import base64
import io
import json
import struct
import zipfile
import zlib
from typing import Any

from PIL import Image

from tests.corpus.forge import chunk, png
from tests.fuzz.bad_texts import Bad


def picture(mode: str, size: tuple[int, int] = (4, 3), form: str = "PNG") -> bytes:
    """Return a black image with a mode and format of Pillow."""
    stream = io.BytesIO()
    Image.new(mode, size).save(stream, form)
    return stream.getvalue()


def npy(header: str, body: bytes = b"", version: bytes = b"\1\0") -> bytes:
    """Return a .npy file with this header."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text + body


def shape(axes: str, dtype: str = "<f4") -> str:
    """Return the header of a .npy file with this shape."""
    return f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({axes})}}"


def archive(method: int = zipfile.ZIP_STORED, **members: bytes) -> bytes:
    """Return a ZIP archive of .npy files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method, compresslevel=1) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return stream.getvalue()


WEIGHT, BIAS = "features.0.weight", "features.0.bias"
_PNG: dict[str, bytes] = {
    "bomb": png(60_000, 60_000),
    "16 bits": png(4, 3, depth=16, rows=bytes(75)),
    "2 bits": png(4, 3, depth=2, kind=0, rows=bytes(6)),
    "palette": picture("P"),
    "grey": picture("L"),
    "one colour transparent": png(1, 1, rows=bytes(4), more=chunk(b"tRNS", bytes(6))),
    "another format": picture("RGB", form="BMP"),
}

_NPY: dict[str, bytes] = {
    "terabytes": npy(shape("1048576, 1048576, 3")),
    "records": npy("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1, 1, 3)}", bytes(12)),
    "newer version": npy(shape("1, 1, 3"), bytes(12), b"\x09\0"),
}

_WEIGHTS: dict[str, bytes] = {
    "nothing": archive(),
    "bomb": archive(zipfile.ZIP_DEFLATED, **{BIAS: npy(shape("16777216"), bytes(1 << 26))}),
    "objects": archive(**{BIAS: npy(shape("1", "|O"), bytes(8))}),
    "shape": archive(**{WEIGHT: npy(shape("32, 3, 3, 3"), bytes(3456))}),
    "integers": archive(**{WEIGHT: npy(shape("64, 3, 3, 3", "<i4"), bytes(6912))}),
    "NaN": archive(**{WEIGHT: npy(shape("64, 3, 3, 3"), b"\xff" * 6912)}),
}

_NEUS: dict[str, bytes] = {
    "nothing": archive(),
    "no scale": archive(world_mat_0=npy(shape("4, 4", "<f8"), bytes(128))),
    "terabytes": archive(world_mat_0=npy(shape("1048576, 1048576"))),
    "bomb": archive(zipfile.ZIP_DEFLATED, world_mat_0=bytes(1 << 26), scale_mat_0=b""),
}


def page(scene: Any, array: bytes = zlib.compress(bytes(45))) -> bytes:
    """Return a page with a scene and one array."""
    text = scene if isinstance(scene, bytes) else json.dumps({"dedicated": scene}).encode()
    return b'<script type="application/json" id="scene">%b</script>' % text + (
        b'<script type="text/plain" data-array="a">%b</script>' % base64.b64encode(array)
    )


def one_view(width: int = 5, height: int = 3, tests: int = 1, **head: Any) -> dict[str, Any]:
    """Return the scene of a page with test views."""
    test = {"image": "a", "view": {"width": width, "height": height}}
    whole = {"type": "uint8", "shape": [15, 3], "how": "plain", "bytes": 45}
    return {"tests": [test] * tests, "arrays": {"a": {**whole, **head}}}


_PAGE: dict[str, bytes] = {
    "no scene": b"<html></html>",
    "nested": page(b"[" * 5000 + b"]" * 5000),
    "image without an array": page({**one_view(), "arrays": {}}),
    "bomb": page(one_view(bytes=1 << 30), zlib.compress(bytes(1 << 24))),
    "many views of one bomb": page(one_view(10_000, 10_000, tests=9)),
    "negative size": page(one_view(-5, -3)),
    "rows of one row": page(one_view(how="rows", codes="uint8", shape=[45, 1 << 40])),
}

ABOUT = npy(shape("2,", "|u1"), b"{}")
_TRAINING: dict[str, bytes] = {
    "empty": b"",
    "a text": archive(about=ABOUT, a=b"text"),
}
BAD: dict[str, Bad] = {
    f"{target}: {name}": (target, content, code)
    for target, code, table in (
        ("image_png", "METRIC_IMAGE", _PNG),
        ("image_npy", "METRIC_IMAGE", _NPY),
        ("vgg_npz", "METRIC_WEIGHTS", _WEIGHTS),
        ("neus_npz", "SCENE_LAYOUT", _NEUS),
        ("page", "FILE_NOT_RECOGNISED", _PAGE),
        ("training", "USAGE", _TRAINING),
    )
    for name, content in table.items()
}
