"""The text of every command: its help and its usual output on shipped data, in one file per command.

Other tests assert codes, values and files. Whoever changes a sentence writes these files again and reads the
difference::

    python -m tests.snapshots

Times, hashes, versions and paths are replaced by words. In the output of commands that measure, so is every
number, because it depends on the machine.
"""

import contextlib
import io
import os
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from msb.cli import commands
from tests.cli.forks import run_msb
from tests.conftest import ROOT
from tests.tiny import link_demo

FOLDER = Path(__file__).parent
ASSET = "data_stubs/splat_like.triasset"
CHECKPOINT = "data_stubs/checkpoint"
VIEWS = "--cameras data_stubs/views.json --scale 0.1"
USUAL = {
    "audit": [
        f"audit {ASSET}",
        f"audit --quiet --fail-on components>999 {ASSET} missing.ply",
        "audit --explain lcc_area_ratio",
    ],
    "view": [f"view --html out/view.html {ASSET}"],
    "trial": [f"trial --task intersections {ASSET}"],
    "repair": [f"repair {ASSET} out/repaired.ply"],
    "info": [f"info {ASSET}"],
    "validate": [f"validate {ASSET}", "validate --explain TRIASSET_INDEX_OUT_OF_RANGE"],
    "export": [f"export {CHECKPOINT} out/demo.triasset"],
    "convert": [f"convert {CHECKPOINT} out/upright.glb"],
    "bake": [f"bake --seconds 0 --geometry kept -o out/baked.glb {VIEWS} {CHECKPOINT}"],
    "score": [
        "score --pose capture --capture data_stubs/scenes/mipnerf360/pebble "
        "data_stubs/models/walled/mesh_splatting"
    ],
    "lod": [f"lod --lods 0.5 --collision box -o out/plain.glb {CHECKPOINT}"],
    "why": [f"why {VIEWS} {CHECKPOINT}"],
    "methods": ["methods"],
    "render": [f"render {VIEWS} --out out/images {CHECKPOINT}"],
    "compare": [f"compare {VIEWS} --html out/compare.html {CHECKPOINT}"],
    "web": [f"web --out out/web.html {ASSET}"],
    "bench": [f"bench {VIEWS} --repeat 2 --seconds 0 {CHECKPOINT}"],
    "scenes": ["scenes data_stubs/scenes", "scenes data_stubs/scenes/dtu/scan1"],
    "run": ["run --dry-run --only two_dts/nerf_synthetic data_stubs/protocol.toml"],
    "eval": ["eval tests/golden/metrics/pred tests/golden/metrics/gt"],
    "submit": [
        "run --quiet -o out/run --only two_dts/nerf_synthetic/standard data_stubs/protocol.toml",
        "submit out/run -o out/ours.zip --name us",
    ],
    "report": ["report --paper --table mesh_connectivity"],
    "track": ["track -o out/track.json -- true"],
    "demo-data": ["demo-data out/demo-data"],
}
"""Command -> command lines, whose output is the same on every machine except for numbers."""
MEASURES = {"bake", "bench", "lod", "render", "repair", "score", "submit", "track", "trial", "why"}
"""Commands whose numbers are replaced."""
_WORDS = (
    (re.compile(r"\b[0-9a-f]{12,64}\b"), "HASH"),
    (re.compile(r"\b[\d.]+ (µs|ms|s)\b"), "N s"),
    (re.compile(r"\b[\d,]+ bytes\b"), "N bytes"),
    (re.compile(r"(msb-\w+ \S+) on .*"), r"\1 on DEVICE"),
    (re.compile(r"\bGPU not measured .*"), "GPU ..."),
    (re.compile(r"\b\d+\.\d+\.\d+\b"), "VERSION"),
)
_NUMBER = re.compile(r"(?<![A-Z\d])(?<!sha)\d[\d.,]*")
_BLANKS = re.compile(r"(?<=\S)  +")


def names() -> list[str]:
    """Return the built-in commands that are installed."""
    listed = commands.listed()
    return [name for heading in commands.BUILT_IN for name in listed.get(heading, ())]


def help_text(command: str) -> str:
    """Return the help of a command, or of `msb` for an empty name, as a pipe gets it."""
    from msb.cli.app import app
    from msb.cli.process import run

    words = ["msb", *command.split(), "--help"]
    text = io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS="80"),
        mock.patch.object(sys, "argv", words),
        contextlib.redirect_stdout(text),
    ):
        assert run(app, "msb") == 0
    return f"$ {shlex.join(words)}\n{text.getvalue()}"


def usual_text(command: str, folder: Path) -> str:
    """Return the output of a command's usual lines, run in an empty folder."""
    link_demo(folder)
    (folder / "tests").symlink_to(ROOT / "tests")
    text = "".join(_shown(line, folder) for line in USUAL.get(command, ()))
    for pattern, word in _WORDS:
        text = pattern.sub(word, text)
    return _without_numbers(text) if command in MEASURES else text


def _shown(line: str, folder: Path) -> str:
    """Return a command line with its output, and its exit status unless it is 0."""
    plain = {"NO_COLOR": "1", "FORCE_COLOR": None, "COLUMNS": "80"}
    done = run_msb(shlex.split(line), folder, plain)
    out, err = (stream.decode().replace(str(folder), "FOLDER") for stream in (done.stdout, done.stderr))
    lines = [f"$ msb {line}", *out.splitlines(), *(f"[stderr] {text}" for text in err.splitlines())]
    lines += [f"[status] {done.returncode}"] if done.returncode else []
    return "".join(f"{text.rstrip()}\n" for text in lines)


def _without_numbers(text: str) -> str:
    """Replace numbers, and blanks that align them, except in the command lines."""
    lines = text.splitlines()
    changed = (line if line.startswith("$") else _BLANKS.sub("  ", _NUMBER.sub("N", line)) for line in lines)
    return "".join(f"{line}\n" for line in changed)


def file_of(command: str) -> Path:
    """Return the file of a command."""
    return FOLDER / f"{command or 'msb'}.txt"


def parts(command: str) -> Iterator[str]:
    """Yield the stored help and the stored usual output."""
    text = file_of(command).read_text(encoding="utf-8")
    first, separator, rest = text.partition(SEPARATOR)
    yield first
    yield rest if separator else ""


SEPARATOR = "\n" + 80 * "-" + "\n\n"
"""It stands between the help and the usual output."""
