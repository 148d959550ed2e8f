"""Invalid protocols and records are rejected with the right error code."""

import json
from pathlib import Path
from typing import Any

import pytest

from fuzz.targets import TARGETS
from msb.bench.documents import STORED
from tests.bench.test_protocol import MINIMAL
from tests.bench.test_track import TIMING
from tests.fuzz.bad_texts import Bad
from tests.report.factory import AUDIT, TASK, chamfer, make_result, repairs, strategy_json, trial

DIGITS = b"1" * 5000
"""A decimal number with more digits than Python converts."""
HEXADECIMAL = b"0x" + b"f" * 5000
"""A hexadecimal number with more decimal digits than Python converts to text."""


def protocol(more: bytes, old: str = "", new: str = "") -> bytes:
    """Return a valid protocol in which `old` is replaced by `new`, and `more` is appended."""
    return (MINIMAL.replace(old, new) if old else MINIMAL).encode() + more


def result(**changes: Any) -> bytes:
    """Return a valid record with some of its keys replaced."""
    record = json.loads(make_result("capture", "desk", "two_dts", "dedicated").to_json())
    return json.dumps({**record, **changes}).encode()


def first_image(**changes: Any) -> bytes:
    """Return a valid record with some keys of its first image replaced."""
    quality = json.loads(result())["quality"]
    quality["images"][0] |= changes
    return result(quality=quality)


_NESTED = b'{"a":' * 5000 + b"1" + b"}" * 5000

_PROTOCOL: dict[str, bytes] = {
    "number of 5000 digits": b"x = " + DIGITS,
    "hexadecimal of 5000 digits": protocol(b"resolution = " + HEXADECIMAL),
    "long place": protocol(b"", "{scene}", "{" + "s" * 9000 + "}"),
    "lone surrogate": b'x = "\\ud800"',
    "too long": b"#" * ((1 << 20) + 1),
}


_RESULT: dict[str, bytes] = {
    "empty": b"",
    "not JSON": result()[:-5],
    "no object": b"[]",
    "lone surrogate": result().replace(b'"done"', b'"\\ud800"'),
    "faces are a string": result(audit={**AUDIT, "counts": {**AUDIT["counts"], "faces": "9"}}),
    "chamfer distance is a boolean": result(chamfer={**chamfer(1), "overall": True}),
    "negative PSNR": first_image(psnr=-3.0),
    "wrong average of SSIM": first_image(ssim=0.25),
    "trial without time": result(trial=trial({**TASK, "seconds": None})),
    "repair with a list of trials": result(repairs=repairs(strategy_json(STORED, trials=["uv"]))),
    "repairs without the original": result(repairs=repairs(strategy_json("weld"))),
    "image without width": result(quality={"psnr": 1, "ssim": 1, "images": [{"name": "a"}]}),
}

_RECORDS: dict[str, Bad] = {
    f"{target}: {name}": (target, content, code)
    for target, code in (
        ("track", "RECORD_INVALID"),
        ("renderer_timing", "RECORD_INVALID"),
        ("published", "RECORD_INVALID"),
        ("benchmark", "FILE_NOT_RECOGNISED"),
    )
    for name, content in (
        ("not JSON", b'{"schema":'),
        ("nested", _NESTED),
        ("long integer", b'{"schema": ' + DIGITS + b"}"),
        ("other schema", b'{"schema": "msb.other/1"}'),
        ("no object", b"[1]"),
        ("too long", b" " * ((1 << 20) + 1)),
    )
    if (target, name) not in (("renderer_timing", "too long"), ("published", "too long"))
} | {
    f"renderer_timing: {key} is {value!r}": (
        "renderer_timing",
        json.dumps({**TIMING, key: value}).encode(),
        "RECORD_INVALID",
    )
    for key, value in (
        ("frames", 0),
        ("frames", 1.5),
        ("device", ""),
        ("peak_gpu_memory_bytes", -1),
        ("fps", 9),
    )
}

BAD: dict[str, Bad] = (
    {f"protocol: {name}": ("protocol", content, "PROTOCOL_INVALID") for name, content in _PROTOCOL.items()}
    | {f"result: {name}": ("result", content, "RECORD_INVALID") for name, content in _RESULT.items()}
    | _RECORDS
)


@pytest.mark.parametrize("name", BAD)
def test_bad_content(name: str, tmp_path: Path) -> None:
    target, content, code = BAD[name]
    assert TARGETS[target].at(tmp_path)(content).code == code
