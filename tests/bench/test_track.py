"""What a command costs, its status, signals and arguments; and how fast a method's own renderer is."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from msb.bench.gaps import slowdown
from msb.bench.nvml import Gpus, driver_memory
from msb.bench.records import RendererTiming, read_renderer_timing
from msb.bench.run import run_protocol
from msb.bench.track import WHOLE_COMMAND, read_track, track
from msb.errors import MsbError
from msb.report.collect import collect
from msb.report.numbers import MEAN, Key, RatioKey
from msb.report.results import read_results
from tests.bench.nvml import ME, nvml
from tests.bench.protocols import cell, protocol, until
from tests.cli.conftest import Msb
from tests.cli.forks import run_msb
from tests.conftest import ROOT
from tests.report.factory import result

TAKE = "held = bytearray(200 << 20); held[::4096] = b'x' * len(held[::4096])"
HOLD = f"import time; {TAKE}; time.sleep(1)"


@pytest.mark.slow
def test_time_memory_and_status() -> None:
    found = track([sys.executable, "-c", f"{HOLD}; raise SystemExit(7)"], interval=0.02)
    assert found.exit_status == 7
    assert 0.5 <= found.seconds < 30
    assert 200 << 20 <= found.peak_host_memory_bytes < 400 << 20
    assert found.command[0] == sys.executable
    assert found.started <= found.ended


@pytest.mark.slow
def test_memory_of_children_counts() -> None:
    child = f"{TAKE}; print(flush=True); input()"
    code = (
        "import sys, time\nfrom subprocess import PIPE, Popen\n"
        f"children = [Popen([sys.executable, '-c', {child!r}], stdin=PIPE, stdout=PIPE) for _ in '12']\n"
        "for child in children: child.stdout.readline()\n"
        "time.sleep(1)\n"
        "for child in children: child.communicate(b'\\n')"
    )
    found = track([sys.executable, "-c", code], interval=0.02)
    assert found.peak_host_memory_bytes > 400 << 20


def test_the_record_comes_back_as_it_was_written(tmp_path: Path) -> None:
    found = track([sys.executable, "-c", "pass"])
    (tmp_path / "t.json").write_bytes(found.to_json())
    assert read_track(tmp_path / "t.json") == found
    (tmp_path / "t.json").write_bytes(found.to_json().replace(b"msb.track/1", b"msb.track/9"))
    with pytest.raises(MsbError, match="RECORD_INVALID"):
        read_track(tmp_path / "t.json")


def test_a_program_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(MsbError, match="FILE_NOT_FOUND"):
        track([str(tmp_path / "nothing")])
    (tmp_path / "data").write_text("x")
    with pytest.raises(MsbError, match="FILE_UNREADABLE"):
        track([str(tmp_path / "data")])


STRANGER = 2**22 + 12345  # no number a process of ours can have


@pytest.mark.parametrize(
    ("looks", "wanted"),
    [
        # (what processes hold, what the device holds), from before the command on
        ([({}, 100), ({ME: 300, 1: 50}, 450), ({ME: 200}, 300)], (300, "processes", None)),
        ([({1: 50}, 100), ({1: 60}, 700)], (0, "processes", None)),  # all that is told belongs to others
        ([({}, 100), ({}, 400), ({}, 350)], (300, "device", None)),  # in a container: none is told
        ([({}, 100), ({STRANGER: 200}, 300)], (200, "device", None)),  # or the host's numbers are
        ([({}, 100), ({ME: None}, 180)], (80, "device", None)),  # Windows: listed, but not how much
        ([({}, 100), ({}, 100)], (0, "processes", None)),
    ],
)
def test_gpu_memory_is_of_processes_or_else_of_the_device(
    monkeypatch: pytest.MonkeyPatch, looks: list[tuple[dict[int, int | None], int]], wanted: tuple[Any, ...]
) -> None:
    driver = nvml(*looks[0])
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    gpus = Gpus()
    for driver.held, driver.used in looks[1:]:
        gpus.look({ME})
    assert gpus.result() == wanted
    (only,) = gpus.devices()
    assert (only.name, only.uuid, only.peak_bytes) == ("A GPU", "GPU-1", wanted[0])


def test_where_processes_are_not_listed_no_memory_is_made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Any) -> Any:
        raise RuntimeError("no permission")

    driver = nvml({}, 100)
    driver.nvmlDeviceGetComputeRunningProcesses = refuse
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    gpus = Gpus()
    driver.used = 400
    gpus.look({ME})
    assert gpus.result() == (300, "device", None)
    assert gpus.devices()[0].peak_bytes == 300
    driver.used = 100
    gpus = Gpus()
    driver.nvmlDeviceGetMemoryInfo = refuse
    gpus.look({ME})
    assert gpus.result() == (None, None, "NVML: no permission")
    driver.nvmlDeviceGetMemoryInfo = nvml({}, 100).nvmlDeviceGetMemoryInfo
    assert gpus.devices()[0].peak_bytes is None


def test_the_sum_is_of_all_gpus_or_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of two GPUs refuses its list of processes, then also to say what it holds."""
    driver = nvml({ME: 7}, 100, 2)
    listed, memory = driver.nvmlDeviceGetComputeRunningProcesses, driver.nvmlDeviceGetMemoryInfo

    def but_of_the_first(call: Any) -> Any:
        def ask(index: int) -> Any:
            if index == 0:
                raise RuntimeError("no permission")
            return call(index)

        return ask

    driver.nvmlDeviceGetComputeRunningProcesses = but_of_the_first(listed)
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    gpus = Gpus()
    driver.used = 400
    gpus.look({ME})
    assert gpus.result() == (600, "device", None)
    assert [gpu.peak_bytes for gpu in gpus.devices()] == [300, 300]
    driver.used = 100
    gpus = Gpus()
    driver.used = 400
    driver.nvmlDeviceGetMemoryInfo = but_of_the_first(memory)
    gpus.look({ME})
    assert gpus.result() == (None, None, "NVML: no permission")


@pytest.mark.parametrize(
    ("held", "wanted"),
    [({ME: 300, 1: 50}, 300), ({1: 50}, None), ({}, None), ({ME: None}, None)],
)
def test_the_driver_is_asked_for_this_process_alone(
    monkeypatch: pytest.MonkeyPatch, held: dict[int, int | None], wanted: int | None
) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", nvml(held, 700))
    found = driver_memory({"kind": "gpu", "name": "A GPU"})
    assert found[0] == wanted
    assert (found[1] is None) == (wanted is not None)
    assert driver_memory({"kind": "cpu"})[0] is None


def test_without_library_or_gpu_there_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", None)
    peak, source, reason = Gpus().result()
    assert (peak, source) == (None, None)
    assert "extra gpu" in reason
    broken = nvml({}, 0)
    broken.nvmlInit = lambda: (_ for _ in ()).throw(RuntimeError("no driver"))
    monkeypatch.setitem(sys.modules, "pynvml", broken)
    assert Gpus().result() == (None, None, "NVML: no driver")


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
def test_a_signal_that_comes_before_we_know_of_the_command_reaches_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start = subprocess.Popen

    def early(command: list[str]) -> subprocess.Popen[bytes]:
        child = start(command)
        signal.raise_signal(signal.SIGTERM)
        return child

    monkeypatch.setattr("msb.bench.track.subprocess.Popen", early)
    assert track(["sleep", "60"]).exit_status == 128 + signal.SIGTERM


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
def test_a_signal_that_is_ignored_here_is_ignored_by_the_command() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert track(["sh", "-c", "kill -HUP $$"]).exit_status == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_signals_reach_the_command(tmp_path: Path, number: int) -> None:
    child = (
        "import signal, sys, time\n"
        f"signal.signal({number}, lambda *_: sys.exit(42))\n"
        f"open({str(tmp_path / 'ready')!r}, 'w').close()\ntime.sleep(60)"
    )
    words = ["track", "-o", str(tmp_path / "t.json"), "--", sys.executable, "-c", child]
    process = subprocess.Popen(
        [sys.executable, "-m", "msb", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        until((tmp_path / "ready").exists)
        process.send_signal(number)
        assert process.wait(30) == 42
    finally:
        process.kill()
        process.wait()
    assert read_track(tmp_path / "t.json").exit_status == 42


ECHO = "import sys; print(sys.argv[1:]); sys.exit(3)"


def test_arguments_and_status_go_through(msb: Msb, tmp_path: Path) -> None:
    args = ["--debug", "-q", "--", "--json", "a b", ""]
    result = msb("track", "-o", tmp_path / "t.json", "--", sys.executable, "-c", ECHO, *args, status=3)
    assert result.out == f"{args}\n"
    record = json.loads((tmp_path / "t.json").read_text())
    assert record["schema"] == "msb.track/1"
    assert record["command"] == [sys.executable, "-c", ECHO, *args]
    assert record["exit_status"] == 3
    assert (record["peak_gpu_memory_bytes"] is None) is (record["gpu_reason"] is not None)
    assert str(tmp_path / "t.json") in result.err


def test_a_signal_that_ends_it_is_128_and_more(msb: Msb, tmp_path: Path) -> None:
    code = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    msb("track", "-o", tmp_path / "t.json", sys.executable, "-c", code, status=137)
    msb("track", "-o", tmp_path / "u.json", tmp_path / "nothing", status=3)
    assert not (tmp_path / "u.json").exists()


@pytest.mark.slow
def test_a_record_that_exists_is_kept_before_and_after_the_command(msb: Msb, tmp_path: Path) -> None:
    target, ran = tmp_path / "t.json", tmp_path / "ran"
    write = [sys.executable, "-c", f"open({str(target)!r}, 'w').write('precious'); open({str(ran)!r}, 'w')"]
    assert "\nOUTPUT_EXISTS: " in msb("track", "-o", target, "--", *write, status=2).err
    assert (target.read_text(), ran.exists()) == ("precious", True)
    ran.unlink()
    msb("track", "-o", target, "--", *write).ends(2, "OUTPUT_EXISTS: ")
    assert not ran.exists(), "nothing runs"
    msb("track", "-f", "-o", target, "--", *write, status=0)
    assert json.loads(target.read_text())["schema"] == "msb.track/1"
    msb("track", "-o", "-", "--", *write, cwd=tmp_path).ends(2, "USAGE: --out")


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
