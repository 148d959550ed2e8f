"""`msb bench`: JSON, comparisons with an earlier record, and exit statuses."""

import json
from pathlib import Path

import pytest

import msb as library
from msb.scenes import turntable, write_cameras
from tests.cli.conftest import Here, here

__all__ = ["here"]


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    views = turntable((0.5, 0.5, 0.5), 2.2, up=(0, 1, 0), count=3, width=60, height=44, fov_y=0.7)
    write_cameras(views, tmp_path / "views.json")
    return tmp_path / "views.json"


@pytest.mark.slow
def test_bench_records_and_compares(here: Here, demo_asset: Path, cameras: Path, tmp_path: Path) -> None:
    record = tmp_path / "old.json"
    args = ("bench", "--cameras", cameras, "--repeat", "4", "--seconds", "0")
    assert here(*args, "--json", record, demo_asset).status == 0
    data = json.loads(record.read_text())
    assert data["schema"] == "msb.bench/1"
    assert (data["frames"], data["memory_views"]) == (4, data["views"])
    assert data["machine"]["device"]["platform"]
    assert 0 < data["device_ms"]["p50"] <= data["device_ms"]["p95"]
    assert sum(data["memory_bytes"].values()) > library.load(demo_asset).buffers["indices"].nbytes
    assert sum(data["stages_ms"].values()) <= 2 * data["device_ms"]["p95"]
    assert here(*args, "--compare", record, demo_asset).status == 0
    fast = {**data, "device_ms": {**data["device_ms"], "p50": data["device_ms"]["p50"] / 1000}, "faces": 1}
    (tmp_path / "fast.json").write_text(json.dumps(fast))
    result = here(*args, "--compare", tmp_path / "fast.json", "--fail-slower", "900%", demo_asset)
    note, failure = result.err.splitlines()
    assert result.status == 1
    assert "34761" in note  # faces differ: not the same is compared
    assert failure.startswith("GATE_FAILED: ")
    here(*args, "--compare", record, "--fail-slower", "ten", demo_asset).ends(2, "USAGE: --fail-slower")
    modes = ("--tier", "dedicated", "--order", "none", "--sampling", "engine")
    data = here(*args, *modes, "--json", "-", demo_asset).json
    assert (data["order"], data["sampling"]) == ("none", "engine")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_what_was_measured_is_printed_though_the_record_cannot_be_written(
    here: Here, demo_asset: Path, cameras: Path
) -> None:
    line = (
        "bench",
        "--cameras",
        cameras,
        "--repeat",
        "2",
        "--seconds",
        "0",
        "--json",
        "/dev/full",
        demo_asset,
    )
    result = here(*line)
    assert (result.status, result.err.split(":")[0]) == (3, "OUTPUT_UNWRITABLE")
    assert str(demo_asset) in result.out


@pytest.mark.parametrize(
    ("content", "code"),
    [("{}", "FILE_NOT_RECOGNISED"), ("[", "FILE_NOT_RECOGNISED"), (None, "FILE_NOT_FOUND")],
)
def test_a_record_that_cannot_be_read_ends_the_command(
    here: Here, demo_asset: Path, tmp_path: Path, content: str | None, code: str
) -> None:
    if content is not None:
        (tmp_path / "bad.json").write_text(content)
    here("bench", "--compare", tmp_path / "bad.json", demo_asset).ends(3, f"{code}: ")


def test_bench_rejects_modes_that_a_tier_does_not_have(here: Here, demo_asset: Path) -> None:
    for option, value in (("--order", "tile"), ("--sampling", "engine")):
        here("bench", option, value, demo_asset).ends(4, "UNSUPPORTED_OPTION: ")
