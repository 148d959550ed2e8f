"""Bad TOML, JSON and YAML: name -> fuzz target, content, code, and a piece of the message."""

from __future__ import annotations

import json
from typing import Any

from msb.bench.documents import STORED
from tests.bench.test_protocol import MINIMAL
from tests.report.documents import AUDIT, SAME, TASK, chamfer, repairs, trial, way
from tests.report.factory import make_result

Bad = tuple[str, bytes, str, str]
DIGITS = b"1" * 5000
"""More than Python turns into a number."""
HEXADECIMAL = b"0x" + b"f" * 5000
"""A number that Python makes, but does not print."""
BIG = b"1" + b"0" * 400
"""No float is that large."""


def protocol(more: bytes, old: str = "", new: str = "") -> bytes:
    """Return a small good protocol with an end, or with a change."""
    return MINIMAL.replace(old, new).encode() + more if old else MINIMAL.encode() + more


def result(**changes: Any) -> bytes:
    """Return a good record with some of its keys replaced."""
    made = json.loads(make_result("capture", "desk", "two_dts", "dedicated").to_json())
    return json.dumps({**made, **changes}).encode()


def without(held: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in held.items() if name != key}


def audited(**changes: Any) -> bytes:
    return result(audit={**AUDIT, **changes})


def repaired(**changes: Any) -> bytes:
    return result(repairs=repairs(way(STORED, **changes)))


def measured(image: dict[str, Any] | None = None, **changes: Any) -> bytes:
    """Return a good record with some keys of its quality, or of its first image, replaced."""
    quality = json.loads(result())["quality"]
    quality["images"][0] |= image or {}
    return result(quality={**quality, **changes})


TIMING: dict[str, Any] = {
    "schema": "msb.renderer_timing/1",
    "frames": 300,
    "seconds": 2.5,
    "device": "NVIDIA RTX 4090",
    "timed": "render() of the test views",
}
_NESTED = b'{"a":' * 5000 + b"1" + b"}" * 5000

_PROTOCOL: dict[str, tuple[bytes, str]] = {
    "number of 5000 digits": (b"x = " + DIGITS, "it is not TOML: Exceeds the limit"),
    "hexadecimal of 5000 digits": (protocol(b"resolution = " + HEXADECIMAL), "it holds what it may not"),
    "dotted keys": (b"a." * 2000 + b"a = 1", "nested too deeply"),
    "long place": (protocol(b"", "{scene}", "{" + "s" * 9000 + "}"), "there is no {sss"),
    "date": (b"x = 2020-99-99", "it is not TOML"),
    "UTF-16": (MINIMAL.encode("utf-16"), "it is not TOML"),
    "key twice": (protocol(b'name = "dtu"\n'), "it is not TOML"),
    "lone surrogate": (b'x = "\\ud800"', "it is not TOML"),
    "too long": (b"#" * ((1 << 20) + 1), "longer than"),
}

_SETTINGS: dict[str, tuple[bytes, str]] = {
    "hexadecimal of 5000 digits": (b"quiet = " + HEXADECIMAL, "it must be true or false"),
    "list of huge numbers": (b"[render]\nset = [" + HEXADECIMAL + b"]", "a list of texts or numbers"),
    "brackets": (b"x = " + b"[" * 5000, "nested too deeply"),
    "key with a line break": (b'"a\\nb" = 1', "is no option"),
    "array of tables": (b"[[audit]]\nquiet = true\n", "is no option"),
    "not UTF-8": (b"\xff", "it is no TOML"),
    "too long": (b"#" * ((1 << 20) + 1), "more than 1048576 bytes"),
}

_PYPROJECT: dict[str, tuple[bytes, str]] = {
    "tool is a list": (b"[[tool]]\nmsb = 1 # tool.msb", '"tool" is [{'),
    "msb is a number": (b"tool.msb = 1", '"tool.msb" is 1; it must be a table'),
}

_RESULT: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "not JSON": (result()[:-5], "is not JSON"),
    "not UTF-8": (b"\xff", "is not UTF-8"),
    "nested": (_NESTED, "nests 5000 levels"),
    "no object": (b"[]", "object"),
    "NaN": (result().replace(b'"seconds": 1.5', b'"seconds": NaN'), "holds NaN"),
    "overflow": (result().replace(b'"seconds": 1.5', b'"seconds": 1e999'), "overflows"),
    "key twice": (b'{"schema": 1, "schema": 1}', "twice"),
    "long integer": (result().replace(b'"seconds": 1.5', b'"seconds": ' + DIGITS), "5000 digits"),
    "lone surrogate": (result().replace(b'"done"', b'"\\ud800"'), "surrogate"),
    "other schema": (result(schema="msb.result/3"), "/schema"),
    "unknown key": (result(more=1), "/more: there is no such key"),
    "true for a number": (result(seconds=True), "/seconds"),
    "status": (result(status="fine"), "/status"),
    "audit of a text": (audited(counts={**AUDIT["counts"], "faces": "9"}), "/audit/counts/faces"),
    "audit without counts": (result(audit=without(AUDIT, "counts")), "/audit/counts"),
    "audit of few metrics": (audited(metrics={"vf_ratio": "0.5"}), "/audit/metrics/vf_ratio"),
    "verdict": (audited(verdict={"level": "good", "sentence": "x"}), "/audit/verdict/level"),
    "chamfer of a text": (result(chamfer={**chamfer(1), "overall": "0.5"}), "/chamfer/overall"),
    "chamfer of a truth": (result(chamfer={**chamfer(1), "overall": True}), "/chamfer/overall"),
    "chamfer of nothing": (result(chamfer={}), "/chamfer/overall"),
    "negative PSNR": (measured({"psnr": -3.0}), "/quality/images/0/psnr: -3 dB, and no PSNR is negative"),
    "PSNR that is not there": (measured({"psnr": None}), "/quality/images/0/psnr: it must be there"),
    "other mean of PSNR": (measured(psnr=99.0), "/quality/psnr: it is 99.0, and the mean of its images is"),
    "other mean of SSIM": (measured({"ssim": 0.25}), "/quality/ssim: it is "),
    "trial of no outcome": (result(trial=trial({**TASK, "outcome": []})), "/trial/trials/0/outcome"),
    "trial without a reason": (result(trial=trial(without(TASK, "why"))), "/trial/trials/0/why"),
    "trial of another title": (result(trial=trial({**TASK, "title": 3})), "/trial/trials/0/title"),
    "trial of no time": (result(trial=trial({**TASK, "seconds": None})), "/trial/trials/0/seconds"),
    "repair of no verdict": (repaired(verdict_after=[]), "/repairs/strategies/0/verdict_after"),
    "repair of another verdict": (repaired(verdict_after="fine"), "/repairs/strategies/0/verdict_after"),
    "repair of something else": (repaired(strategy="orient"), "/repairs/strategies"),
    "repair of a text": (repaired(components="4"), "/repairs/strategies/0/components"),
    "repair of one look": (repaired(looks={"standard": SAME}), "/repairs/strategies/0/looks/dedicated"),
    "repair with a list of trials": (repaired(trials=["uv"]), "/repairs/strategies/0/trials"),
    "repair without a reason": (result(repairs=repairs(without(way(STORED), "why"))), "/strategies/0/why"),
    "repair without a picture": (result(repairs=repairs(without(way(STORED), "picture"))), "0/picture"),
    "image without width": (
        result(quality={"psnr": 1, "ssim": 1, "images": [{"name": "a"}]}),
        "/quality",
    ),
}

_RECORDS: dict[str, Bad] = {
    **{
        f"{target}: {name}": (target, content, code, message)
        for target, code in (
            ("track", "RECORD_INVALID"),
            ("renderer_timing", "RECORD_INVALID"),
            ("published", "RECORD_INVALID"),
            ("benchmark", "FILE_NOT_RECOGNISED"),
        )
        for name, content, message in (
            ("empty", b"", "is empty"),
            ("not JSON", b'{"schema":', "is not JSON"),
            ("nested", _NESTED, "nests 5000 levels"),
            ("NaN", b'{"schema": NaN}', "holds NaN"),
            ("long integer", b'{"schema": ' + DIGITS + b"}", "5000 digits"),
            ("key twice", b'{"a": 1, "a": 1}', "twice"),
            ("other schema", b'{"schema": "msb.other/1"}', ""),
            ("no object", b"[1]", ""),
        )
    },
    **{
        f"renderer_timing: {pointer} is {value!r}": (
            "renderer_timing",
            json.dumps({**TIMING, pointer[1:]: value}).encode(),
            "RECORD_INVALID",
            f"{pointer}: ",
        )
        for pointer, value in (
            ("/schema", "msb.track/1"),
            ("/frames", 0),
            ("/frames", 1.5),
            ("/seconds", 0),
            ("/device", ""),
            ("/timed", None),
            ("/peak_gpu_memory_bytes", -1),
            ("/fps", 9),
        )
    },
    "renderer_timing: no seconds": (
        "renderer_timing",
        json.dumps(without(TIMING, "seconds")).encode(),
        "RECORD_INVALID",
        "/seconds: ",
    ),
    "published: text for a value": (
        "published",
        b'{"schema": "msb-paper-table/1", "cells": [{"dataset": "dtu", "scene": "1", "method": "2dts",'
        b' "condition": "dedicated", "metric": "psnr", "value": "20"}]}',
        "RECORD_INVALID",
        "/cells/0/value",
    ),
    "track: too long": ("track", b" " * ((1 << 20) + 1), "RECORD_INVALID", "longer than"),
    "benchmark: too long": ("benchmark", b" " * ((1 << 20) + 1), "FILE_NOT_RECOGNISED", "more than"),
    "benchmark: text for a time": (
        "benchmark",
        b'{"schema": "msb.bench/1", "fps": 1, "device_ms": {"p50": "1"}, "stages_ms": {}, '
        b'"memory_bytes": {}}',
        "FILE_NOT_RECOGNISED",
        "no record of msb bench",
    ),
}

_GATES: dict[str, tuple[bytes, str]] = {
    "infinity": (b"components>inf", "not a finite number"),
    "no number": (b"components>x", "not a finite number"),
    "unknown key": (b"componets>1", "did you mean components"),
    "strange key": (b"nosuch>1", 'no key "nosuch"; msb audit --json has them'),
    "long key": (b"a" * 9000 + b">1", "there is no key"),
    "code": (b"__import__('os')", "not KEY OPERATOR NUMBER"),
}

BAD: dict[str, Bad] = {
    **{
        f"{target}: {name}": (target, content, code, message)
        for target, code, table in (
            ("protocol", "PROTOCOL_INVALID", _PROTOCOL),
            ("msb_toml", "CONFIG_INVALID", _SETTINGS),
            ("pyproject", "CONFIG_INVALID", _PYPROJECT),
            ("result", "RECORD_INVALID", _RESULT),
            ("gate", "USAGE", _GATES),
        )
        for name, (content, message) in table.items()
    },
    **_RECORDS,
}
