"""Commands in unusual environments: no extras, no OpenCL, no home, odd locales and file names, terminals.

Commands with the same environment run in the same process. This is several times as fast.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.cli.conftest import INSTALLED, Msb, of_installed
from tests.cli.forks import SECONDS
from tests.conftest import ROOT, shorten
from tests.tiny import link_demo, write_chair

ASSET = "data_stubs/splat_like.triasset"
CHECKPOINT = "data_stubs/checkpoint"
GOLDEN = "tests/golden/metrics"
DRY = ("run", "--dry-run", "tests/tiny/protocol.toml")
EXTRAS = ("pyvista", "vtk", "igl", "pymeshlab", "manifold3d", "networkx", "torch", "lpips")
EXTRAS += ("xatlas", "fast_simplification", "coacd", "dask", "distributed", "pynvml", "wgpu", "bpy")
EXTRAS += ("skimage", "matplotlib", "jinja2", "OpenEXR", "psutil", "filelock", "av", "trimesh")
EXTRAS += ("pxr", "usd_validation_nvidia")
"""Modules of the extras."""
DRIVER = """
import json, os, sys
commands, absent = json.load(sys.stdin)
commands = [[os.fsdecode(word.encode("latin-1")) for word in words] for words in commands]
sys.modules.update(dict.fromkeys(absent))  # their import fails
from msb.cli import main
for words in commands:
    sys.argv = ["msb", *words]
    status = 0
    try:
        main()
    except SystemExit as end:
        status = end.code
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        stream.buffer.write(b"\\0%d\\0" % status)
        stream.flush()
"""


@dataclass(frozen=True)
class Ended:
    """The exit status and output of a command."""

    words: tuple[str, ...]
    status: int
    out: bytes
    err: bytes


def words_of(lines: str) -> list[tuple[str, ...]]:
    """Return the words of command lines, for installed commands. ASSET and SMALL are abbreviations."""
    small = "--turntable 1 --size 32x24 -o"
    lines = lines.replace("SMALL", small).replace("ASSET", ASSET)
    return [tuple(shlex.split(line)) for line in of_installed(*lines.strip().splitlines())]


def run_all(
    commands: list[tuple[str, ...]], cwd: Path, absent: tuple[str, ...] = (), **env: str | None
) -> list[Ended]:
    """Run commands in one process. Variables in `env` that are None are removed."""
    wanted = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'viewers'}", **env}
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        # Pass words as bytes, because the process can have another encoding.
        input=json.dumps(
            [[[os.fsencode(w).decode("latin-1") for w in command] for command in commands], absent]
        ).encode(),
        capture_output=True,
        cwd=cwd,
        env={key: value for key, value in wanted.items() if value is not None},
        timeout=SECONDS,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    out, err = done.stdout.split(b"\0"), done.stderr.split(b"\0")
    assert len(out) == 2 * len(commands) + 1
    return [Ended(words, int(out[2 * n + 1]), out[2 * n], err[2 * n]) for n, words in enumerate(commands)]


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """Return a folder with the data of the examples."""
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    link_demo(tmp_path)
    write_chair(tmp_path)
    return tmp_path


@pytest.fixture
def nowhere(tmp_path: Path) -> str:
    """Return a folder that not even root can create, because it is below a file."""
    (tmp_path / "file").touch()
    return str(tmp_path / "file" / "folder")


@pytest.mark.slow
def test_a_missing_extra_is_named_in_one_line(work: Path) -> None:
    missing = {
        "bench": f"""
            render --format exr SMALL e ASSET
            eval {GOLDEN}/pred {GOLDEN}/gt
            run -o r tests/tiny/protocol.toml
            report --paper -o paper
            track -o track.json true""",
        "video": "render --film f.mp4 --turntable 2 --size 32x24 ASSET",
        "crosscheck": "audit --cross-check ASSET",
        "trial": "trial ASSET\ntrial --task uv --save kept ASSET",
        "view": "view ASSET\nview --figure f.png ASSET\naudit --view ASSET",
        "wgpu": "render --renderer wgpu SMALL w ASSET",
        "blender": "render --renderer blender_cycles SMALL b ASSET",
        "lpips": f"eval --vgg-weights vgg.pth {GOLDEN}/pred {GOLDEN}/gt",
    }
    named = {words: extra for extra, lines in missing.items() for words in words_of(lines)}
    whole = words_of(f"""
        audit --paper ASSET
        export {CHECKPOINT} a.triasset
        convert ASSET c.stl
        render SMALL s ASSET
        render --film f.gif --turntable 2 --size 32x24 ASSET
        bench --repeat 1 --seconds 0.01 --warmup 0 ASSET
        report --paper --table mesh_connectivity
        methods
        view --html v.html ASSET
        web --out w.html ASSET
        web --tier dedicated --no-verify --cameras data_stubs/views.json --scale 0.1 --out d.html ASSET""")
    *ended, dry = run_all([*named, *whole, DRY], work, EXTRAS, MSB_BLENDER=None)
    for result in ended[: len(named)]:
        line = result.err.decode()
        assert (result.status, result.out, len(line.splitlines())) == (2, b"", 1), line
        assert line.startswith(("EXTRA_MISSING: ", "ENGINE_MISSING: "))
        assert f"meshsplatbench[{named[result.words]}]" in line
    assert {result.words: result.err for result in ended[len(named) :] if result.status} == {}
    assert dry.status == 3
    assert b"\nEXTRA_MISSING: " in dry.err
    assert not {"e", "r", "paper", "track.json", "f.mp4", "f.png", "w", "b"} & {
        p.name for p in work.iterdir()
    }


@pytest.mark.slow
def test_without_opencl_all_but_drawing_works(work: Path, nowhere: str) -> None:
    needs = words_of("""
        render SMALL r ASSET
        render --tier dedicated SMALL r ASSET
        bench ASSET
        run -o res tests/tiny/protocol.toml
        devices
        compare -q --cameras data_stubs/views.json --camera 0 --tiers standard --html c.html ASSET""")
    works = words_of(f"""
        audit ASSET
        export {CHECKPOINT} e.triasset
        convert ASSET c.glb
        eval {GOLDEN}/pred {GOLDEN}/gt
        info ASSET
        validate ASSET
        report --paper --table mesh_connectivity
        render --tier reference SMALL ref ASSET
        view --html v.html ASSET
        web --out w.html ASSET
        web --tier dedicated --no-verify --cameras data_stubs/views.json --scale 0.1 --out d.html ASSET""")
    *ended, dry = run_all([*needs, *works, DRY], work, OCL_ICD_VENDORS=nowhere)
    for result in ended[: len(needs)]:
        lines = result.err.decode().splitlines(keepends=True)
        line = "".join(text for text in lines if not text.startswith("progress: "))
        assert (result.status, result.out, len(line.splitlines())) == (5, b"", 1), line
        assert line.startswith("DEVICE_NOT_FOUND: ")
        assert "OCL_ICD_VENDORS" in line
    assert {result.words[0]: result.status for result in ended[len(needs) :] if result.status} == {}
    assert dry.status == 3
    assert b"\nDEVICE_NOT_FOUND: " in dry.err


@pytest.mark.slow
def test_neither_home_nor_cache_is_needed(work: Path, nowhere: str) -> None:
    commands = words_of("render SMALL r ASSET\nreport --paper -o paper --format html")
    places = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "TMPDIR", "MPLCONFIGDIR")
    ended = run_all(commands, work, POCL_CACHE_DIR=None, **dict.fromkeys(places, nowhere))
    assert [(result.status, result.err) for result in ended] == [(0, b"")] * len(commands)
    (result,) = run_all([("info", ASSET)], work, **dict.fromkeys(places))
    assert result.status == 0


def test_a_pocl_cache_that_cannot_be_written_is_named(msb: Msb, nowhere: str) -> None:
    result = msb("devices", POCL_CACHE_DIR=nowhere, MSB_DEVICE="pocl")
    if "found no platform" in result.err:
        pytest.skip("PoCL is not installed")
    assert result.status == 5
    assert "POCL_CACHE_DIR=" in result.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "name"),
    [
        ({"PYTHONIOENCODING": "ascii"}, r"V\xf6gel \u7f51"),
        (
            {"PYTHONIOENCODING": None, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
            r"V\udcc3\udcb6gel \udce7\udcbd\udc91",
        ),
        ({"PYTHONIOENCODING": "latin-1", "LANG": "de_DE.ISO-8859-1"}, r"Vögel \u7f51"),
    ],
    ids=["ascii", "C", "latin-1"],
)
def test_a_stream_gets_what_it_can_write(work: Path, env: dict[str, str | None], name: str) -> None:
    (work / "Vögel 网.triasset").symlink_to(ROOT / ASSET)
    commands: list[tuple[str, ...]] = [
        ("audit", "Vögel 网.triasset"),
        ("audit", "--paper", ASSET),
        ("audit", "网.ply"),
        ("info", "Vögel 网.triasset"),
        ("convert", "Vögel 网.triasset", "网.ply"),
        ("audit", "--help"),
    ]
    ended = run_all(commands, work, **env)
    assert {result.words: result.status for result in ended if result.status} == {("audit", "网.ply"): 3}
    encoding = "latin-1" if env["PYTHONIOENCODING"] == "latin-1" else "ascii"
    text = {result.words: (result.out + result.err).decode(encoding) for result in ended}
    assert text["audit", "Vögel 网.triasset"].startswith(f"{name}.triasset: BAD")
    assert f"{name}.triasset" in text["info", "Vögel 网.triasset"]
    assert (work / "网.ply").exists()


NAMES = (
    '-v with space 网格 🦊 new\nline\x1b[31m\x7f it\'s "[bold]" per%20cent#?&x$HOME*',
    os.fsdecode(b"bytes\xff\xe4"),
    "ü" * 110,
)
"""Characters with a meaning for shells, terminals, markup and URLs; invalid UTF-8; a long name."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems reject some of these names")
def test_any_file_name_will_do(tmp_path: Path) -> None:
    commands: list[tuple[str, ...]] = []
    for name in NAMES:
        (tmp_path / name).mkdir()
        shutil.copy(ROOT / ASSET, tmp_path / name / f"{name}.triasset")
        place = f"./{name}/{name}"
        commands += [
            ("audit", f"--json={place}.json", f"--csv={place}.csv", f"--log-file={place}.log", f"./{name}"),
            ("validate", f"{place}.triasset"),
            ("convert", f"{place}.triasset", f"{place}.obj"),
            *([("view", "--html", f"{place}v.html", f"{place}.triasset")] if "view" in INSTALLED else []),
        ]
    for result in run_all(commands, tmp_path):
        assert result.status == 0, result.err
        text = result.out.decode()
        # Names of outputs are printed unchanged for other programs. Names of inputs are escaped.
        assert result.words[0] in ("convert", "view") or all(c.isprintable() or c == "\n" for c in text)
    for name in NAMES:
        document = json.loads((tmp_path / name / f"{name}.json").read_bytes())
        assert document["path"].endswith(f"{name}.triasset")
        assert (tmp_path / name / f"{name}.log").exists()


NOT_HERE = {"capture", "compare", "devices", "view"}
"""Commands that are not run here.

capture needs photographs. compare and view open a window. tests/render/test_devices_command.py runs the
examples of devices.
"""


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("which", ["bake", "all others"])
def test_every_help_example_runs(work: Path, which: str) -> None:
    pytest.importorskip("pymeshlab", reason="extra crosscheck is not installed")
    examples: list[tuple[str, ...]] = []
    names = [name for name in INSTALLED if (name == "bake") is (which == "bake")]
    for helped in run_all([(name, "--help") for name in names], work):
        text = helped.out.decode().partition("Examples:")[2].partition("Exit status")[0]
        for line in filter(str.strip, text.replace("\\\n", " ").splitlines()):
            program, *words = shlex.split(line)
            if words[0] not in NOT_HERE:
                line_words = ["msb", *(["audit"] if program == "msb-audit" else []), *words]
                examples.append(tuple(shorten(line_words)[1:]))
    assert {words[0] for words in examples} >= {*names} - NOT_HERE
    ended = run_all(list(dict.fromkeys(examples)), work)
    failed = {result.words: result.err for result in ended if result.status or b"Traceback" in result.err}
    assert not failed, failed


def test_numbers_are_not_wrapped_in_40_columns(msb: Msb) -> None:
    lines = msb("audit", ASSET, COLUMNS="40", TERM="xterm").out.splitlines()
    row = next(line for line in lines if line.startswith("this mesh"))
    assert row.split() == ["this", "mesh", "0.52", "6.46", "0.47", "0.17", "0.74", "0.72", "0.72", "5,799"]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="other systems close pipes in another way")
@pytest.mark.parametrize("line", ["audit --help", f"audit --json - {ASSET}"])
def test_a_closed_pipe_is_not_an_error(line: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as pipe:
        done = subprocess.run(
            [sys.executable, "-m", "msb", *line.split()], stdout=pipe, stderr=subprocess.PIPE, cwd=ROOT
        )
    assert (done.returncode, done.stderr) == (0, b"")
