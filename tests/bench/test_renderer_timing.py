"""How fast a method's own renderer is: the file, its place in a run, and what it is held against."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from msb.bench.gaps import slowdown
from msb.bench.records import RendererTiming, read_renderer_timing
from msb.bench.run import run_protocol
from msb.bench.track import WHOLE_COMMAND
from msb.report.collect import collect
from msb.report.numbers import MEAN, Key, RatioKey
from msb.report.results import read_results
from tests.bench.protocols import cell, protocol
from tests.cli.forks import run_msb
from tests.report.factory import result

TIMING: dict[str, Any] = {
    "schema": "msb.renderer_timing/1",
    "frames": 300,
    "seconds": 2.5,
    "device": "NVIDIA RTX 4090",
    "timed": "render() of the test views",
}


def write(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps({**TIMING, **changes}))
    return path


def test_it_is_read_with_its_rate(tmp_path: Path) -> None:
    found = read_renderer_timing(write(tmp_path / "t.json", peak_gpu_memory_bytes=1 << 30))
    assert found.fps == 120
    assert found.peak_gpu_memory_bytes == 1 << 30
    assert not found.whole_command
    (tmp_path / "again.json").write_bytes(found.to_json())
    assert read_renderer_timing(tmp_path / "again.json") == found


@pytest.mark.parametrize(
    ("device", "whole", "reason"),
    [
        ("Some CPU", False, None),
        ("some cpu", False, None),
        ("NVIDIA RTX 4090", False, "device_mismatch"),
        ("Some CPU", True, "whole_command"),
    ],
)
def test_rates_are_held_against_it_on_the_same_device_only(
    device: str, whole: bool, reason: str | None
) -> None:
    elsewhere = RendererTiming(frames=10, seconds=1.0, device=device, timed="x", whole_command=whole)
    about = {"device": {"platform": "p", "name": "Some CPU", "driver": "1", "kind": "cpu"}}
    own = result("non_engine", renderer_timing=elsewhere, device=None, timing=None)
    records = {"garden": {"non_engine": own, "dedicated": result("dedicated", device=about)}}
    found = slowdown(records, ["garden"], "dedicated", "non_engine")
    assert found.reason == reason
    assert (found.value is None) == (reason is not None)


@pytest.mark.slow
def test_a_run_takes_it_and_the_report_says_where_it_is_from(tmp_path: Path) -> None:
    write(tmp_path / "own.json")
    file = protocol(tmp_path, ("two_dts",), each='non_engine = "reference"\nnon_engine_timing = "own.json"')
    assert run_protocol(file, only=["non_engine"]).exit_status == 0
    assert cell(file, "two_dts/non_engine").renderer_timing.fps == 120
    fps = Key("nerf_synthetic", MEAN, "two_dts", "non_engine", "fps")
    number = collect(read_results(file.results)).number(fps)
    assert number.value == 120
    (note,) = number.notes
    assert TIMING["device"] in note
    assert TIMING["timed"] in note
    write(tmp_path / "own.json", frames=600)
    (row,) = run_protocol(file, only=["non_engine"], dry=True).rows
    assert dict(row.planned.why) == {"renderer_timing": "file changed"}
    write(tmp_path / "own.json", frames=0)
    run_protocol(file, only=["non_engine"])
    numbers = collect(read_results(file.results))
    assert numbers.number(fps).value is None
    assert "/frames" in str(numbers.number(fps).reason)
    assert RatioKey("nerf_synthetic", "two_dts", "dedicated", "non_engine") in numbers.ratios


@pytest.mark.slow
def test_track_writes_one_for_a_whole_command(tmp_path: Path) -> None:
    for status, name in ((0, "own.json"), (3, "no.json")):
        command = ["track", "--frames", "8", "-o", name, "--", sys.executable, "-c", f"exit({status})"]
        done = run_msb(command, tmp_path, {})
        assert done.returncode == status, done.stderr
    found = read_renderer_timing(tmp_path / "own.json")
    assert (found.frames, found.whole_command, found.timed) == (8, True, WHOLE_COMMAND)
    assert not (tmp_path / "no.json").exists()
