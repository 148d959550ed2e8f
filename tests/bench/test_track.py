"""`msb track`: time, memory, exit status and signals of a command, and timings of a method's own renderer."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from msb.bench.gaps import slowdown
from msb.bench.nvml import Gpus, read_driver_memory
from msb.bench.protocol import read_protocol
from msb.bench.records import RendererTiming, read_renderer_timing
from msb.bench.run import run_protocol
from msb.bench.track import WHOLE_COMMAND, TrainingLog, read_track, read_training_record, track
from msb.errors import InputError, MsbError
from msb.report.collect import collect
from msb.report.numbers import MEAN, Key, RatioKey
from msb.report.results import read_results
from tests.bench.nvml import ME, nvml
from tests.bench.protocols import make_protocol, read_cell, wait_until
from tests.cli.conftest import Msb
from tests.cli.forks import run_msb
from tests.conftest import ROOT
from tests.report.factory import result

posix = pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")
TAKE = "held = bytearray(200 << 20); held[::4096] = b'x' * len(held[::4096])"


@pytest.mark.slow
def test_time_status_and_memory_of_all_child_processes() -> None:
    child = f"{TAKE}; print(flush=True); input()"
    code = (
        "import sys, time\nfrom subprocess import PIPE, Popen\n"
        f"children = [Popen([sys.executable, '-c', {child!r}], stdin=PIPE, stdout=PIPE) for _ in '12']\n"
        "for child in children: child.stdout.readline()\n"
        "time.sleep(1)\n"
        "for child in children: child.communicate(b'\\n')\n"
        "sys.exit(7)"
    )
    record = track([sys.executable, "-c", code], interval=0.02)
    assert record.exit_status == 7
    assert 1 <= record.seconds < 60
    assert 400 << 20 < record.peak_host_memory_bytes < 700 << 20
    assert record.command[0] == sys.executable
    assert record.started <= record.ended


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    record = track([sys.executable, "-c", "pass"])
    (tmp_path / "t.json").write_bytes(record.to_json())
    assert read_track(tmp_path / "t.json") == record


def test_missing_and_invalid_programs_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("x")
    for name, code in (("nothing", "FILE_NOT_FOUND"), ("data", "FILE_UNREADABLE")):
        with pytest.raises(MsbError, match=code):
            track([str(tmp_path / name)])


FOREIGN = 2**22 + 12345  # above the largest process number of Linux


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        # pairs (bytes per process, bytes in use on the device): first before the command, then during the
        # command
        ([({}, 100), ({ME: 300, 1: 50}, 450), ({ME: 200}, 300)], (300, "processes", None)),
        ([({1: 50}, 100), ({1: 60}, 700)], (0, "processes", None)),  # only other programs use the GPU
        ([({}, 100), ({}, 400), ({}, 350)], (300, "device", None)),  # in a container no process is listed
        ([({}, 100), ({FOREIGN: 200}, 300)], (200, "device", None)),  # or with the host's process numbers
        ([({}, 100), ({ME: None}, 180)], (80, "device", None)),  # Windows lists processes without memory
        ([({}, 100), ({}, 100)], (0, "processes", None)),
    ],
)
def test_gpu_memory_is_measured_per_process_or_for_the_device(
    monkeypatch: pytest.MonkeyPatch,
    states: list[tuple[dict[int, int | None], int]],
    expected: tuple[Any, ...],
) -> None:
    driver = nvml(*states[0])
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    gpus = Gpus()
    for driver.held, driver.used in states[1:]:
        gpus.look({ME})
    assert gpus.result() == expected
    (gpu,) = gpus.devices()
    assert (gpu.name, gpu.uuid, gpu.peak_bytes) == ("A GPU", "GPU-1", expected[0])


@pytest.mark.parametrize("count", [1, 2])
def test_gpu_memory_if_the_first_gpu_denies_access(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """The driver first denies the list of processes of GPU 0, and then also its memory in use."""
    driver = nvml({ME: 7}, 100, count)

    def deny_first(name: str) -> None:
        call = getattr(driver, name)

        def ask(index: int) -> Any:
            if index == 0:
                raise RuntimeError("no permission")
            return call(index)

        setattr(driver, name, ask)

    deny_first("nvmlDeviceGetComputeRunningProcesses")
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    first, second = Gpus(), Gpus()
    driver.used = 400
    first.look({ME})
    assert first.result() == (300 * count, "device", None)
    assert [gpu.peak_bytes for gpu in first.devices()] == [300] * count
    memory = driver.nvmlDeviceGetMemoryInfo
    deny_first("nvmlDeviceGetMemoryInfo")
    second.look({ME})
    assert second.result() == (None, None, "NVML: no permission")
    driver.nvmlDeviceGetMemoryInfo = memory
    assert second.devices()[0].peak_bytes is None


@pytest.mark.parametrize(
    ("held", "expected"), [({ME: 300, 1: 50}, 300), ({1: 50}, None), ({}, None), ({ME: None}, None)]
)
def test_driver_memory_is_that_of_this_process(
    monkeypatch: pytest.MonkeyPatch, held: dict[int, int | None], expected: int | None
) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", nvml(held, 700))
    size, reason = read_driver_memory({"kind": "gpu", "name": "A GPU"})
    assert size == expected
    assert (reason is None) == (expected is not None)
    assert read_driver_memory({"kind": "cpu"})[0] is None


def test_a_missing_library_or_driver_is_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", None)
    peak, source, reason = Gpus().result()
    assert (peak, source) == (None, None)
    assert "extra gpu" in reason
    broken = nvml({}, 0)
    broken.nvmlInit = lambda: (_ for _ in ()).throw(RuntimeError("no driver"))
    monkeypatch.setitem(sys.modules, "pynvml", broken)
    assert Gpus().result() == (None, None, "NVML: no driver")


@posix
def test_a_signal_during_the_start_reaches_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    start = subprocess.Popen

    def early(command: list[str]) -> subprocess.Popen[bytes]:
        child = start(command)
        signal.raise_signal(signal.SIGTERM)
        return child

    monkeypatch.setattr("msb.bench.track.subprocess.Popen", early)
    assert track(["sleep", "60"]).exit_status == 128 + signal.SIGTERM


@posix
def test_an_ignored_signal_stays_ignored_in_the_command() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert track(["sh", "-c", "kill -HUP $$"]).exit_status == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
@posix
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
        wait_until((tmp_path / "ready").exists)
        process.send_signal(number)
        assert process.wait(30) == 42
    finally:
        process.kill()
        process.wait()
    assert read_track(tmp_path / "t.json").exit_status == 42


ECHO = "import sys; print(sys.argv[1:]); sys.exit(3)"


def test_arguments_and_exit_status_are_passed_through(msb: Msb, tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    args = ["--debug", "-q", "--", "--json", "a b", ""]
    output = msb("track", "-o", path, "--", sys.executable, "-c", ECHO, *args, status=3)
    assert output.out == f"{args}\n"
    assert str(path) in output.err
    record = json.loads(path.read_text())
    assert (record["schema"], record["exit_status"]) == ("msb.track/1", 3)
    assert record["command"] == [sys.executable, "-c", ECHO, *args]
    assert (record["peak_gpu_memory_bytes"] is None) is (record["gpu_reason"] is not None)
    killed = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    msb("track", "-f", "-o", path, sys.executable, "-c", killed, status=128 + 9)


@pytest.mark.slow
def test_an_existing_record_is_kept_before_and_after_the_command(msb: Msb, tmp_path: Path) -> None:
    target, ran = tmp_path / "t.json", tmp_path / "ran"
    write = [sys.executable, "-c", f"open({str(target)!r}, 'w').write('precious'); open({str(ran)!r}, 'w')"]
    assert "\nOUTPUT_EXISTS: " in msb("track", "-o", target, "--", *write, status=2).err
    assert (target.read_text(), ran.exists()) == ("precious", True)
    ran.unlink()
    msb("track", "-o", target, "--", *write).ends(2, "OUTPUT_EXISTS: ")
    assert not ran.exists(), "the command was not started"
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


def test_a_renderer_timing_is_read_with_its_frame_rate(tmp_path: Path) -> None:
    timing = read_renderer_timing(write(tmp_path / "t.json", peak_gpu_memory_bytes=1 << 30))
    assert (timing.fps, timing.peak_gpu_memory_bytes, timing.whole_command) == (120, 1 << 30, False)
    (tmp_path / "again.json").write_bytes(timing.to_json())
    assert read_renderer_timing(tmp_path / "again.json") == timing


@pytest.mark.parametrize(
    ("device", "whole", "reason"),
    [
        ("Some CPU", False, None),
        ("some cpu", False, None),
        ("NVIDIA RTX 4090", False, "device_mismatch"),
        ("Some CPU", True, "whole_command"),
    ],
)
def test_frame_rates_are_compared_on_the_same_device_only(
    device: str, whole: bool, reason: str | None
) -> None:
    timing = RendererTiming(frames=10, seconds=1.0, device=device, timed="x", whole_command=whole)
    about = {"device": {"platform": "p", "name": "Some CPU", "driver": "1", "kind": "cpu"}}
    native = result("non_engine", renderer_timing=timing, device=None, timing=None)
    records = {"garden": {"non_engine": native, "dedicated": result("dedicated", device=about)}}
    ratio = slowdown(records, ["garden"], "dedicated", "non_engine")
    assert ratio.reason == reason
    assert (ratio.value is None) == (reason is not None)


@pytest.mark.slow
def test_a_run_records_a_renderer_timing_and_the_report_names_its_source(tmp_path: Path) -> None:
    write(tmp_path / "own.json")
    file = make_protocol(
        tmp_path, ("two_dts",), keys='non_engine = "reference"\nnon_engine_timing = "own.json"'
    )
    assert run_protocol(file, only=["non_engine"]).exit_status == 0
    assert read_cell(file, "two_dts/non_engine").renderer_timing.fps == 120
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
def test_track_writes_a_renderer_timing_of_a_whole_command(tmp_path: Path) -> None:
    for status, name in ((0, "own.json"), (3, "no.json")):
        command = ["track", "--frames", "8", "-o", name, "--", sys.executable, "-c", f"exit({status})"]
        done = run_msb(command, tmp_path, {})
        assert done.returncode == status, done.stderr
    timing = read_renderer_timing(tmp_path / "own.json")
    assert (timing.frames, timing.whole_command, timing.timed) == (8, True, WHOLE_COMMAND)
    assert not (tmp_path / "no.json").exists()


def test_our_trainers_record_gives_the_training_time(tmp_path: Path) -> None:
    (tmp_path / "training.json").write_text('{"method": "x", "iterations": 3, "seconds": 60.5, "note": ""}')
    record = read_training_record(tmp_path / "training.json")
    assert isinstance(record, TrainingLog)
    assert record.seconds == 60.5
    (tmp_path / "training.json").write_text('{"method": "x", "iterations": 3}')
    with pytest.raises(InputError) as caught:
        read_training_record(tmp_path / "training.json")
    assert caught.value.code == "RECORD_INVALID"


@pytest.mark.parametrize("name", ["protocol.toml", "protocol_all.toml"])
def test_the_demos_protocols_name_the_record_of_every_training(name: str) -> None:
    protocol = read_protocol(ROOT / "data_stubs" / name).protocol
    for method in protocol.methods:
        assert method.training is not None
        path = ROOT / "data_stubs" / str(method.training).format(method=method.name)
        assert read_training_record(path).seconds > 0
