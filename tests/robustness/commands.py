"""The commands that are killed: what each reads, writes, and is started with."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from data_stubs.make import write_checkpoint
from msb.bench.run import run_protocol
from tests.bench.protocols import protocol
from tests.conftest import ROOT
from tests.tiny import MODELS

STUBS = ROOT / "data_stubs"
QUICK_VIEWS = ("--cameras", STUBS / "views.json", "--scale", "0.25", "--tiers", "dedicated,standard")
"""Options of `msb compare`: else it draws eight views of 640x480 by the reference, too."""
DEMO = "demo"
"""The folder of demo data: copies of files of every kind, which are compared and not read."""


@dataclass(frozen=True)
class Command:
    """One command to be killed.

    Attributes
    ----------
    name : str
    line : callable
        (folder of the inputs, folder for the outputs) -> arguments of `msb`.
    prepare : callable
        Makes the inputs in a folder; the second argument is how large.
    force : bool
        It refuses to replace what is there without --force.
    environment : callable
        Folder for the outputs -> variables.
    """

    name: str
    line: Callable[[Path, Path], Sequence[object]]
    prepare: Callable[[Path, int], None]
    force: bool = True
    environment: Callable[[Path], Mapping[str, str]] = field(default=lambda _folder: {})

    def argv(self, inputs: Path, out: Path, *, force: bool = False) -> list[str]:
        """Return the arguments of the process."""
        return ["-m", "msb", *map(str, self.line(inputs, out)), *(["--force"] if force else [])]

    def environ(self, folder: Path) -> dict[str, str]:
        """Return the environment of the process."""
        return {**os.environ, "PYTHONPATH": str(ROOT), **self.environment(folder)}


def _checkpoint(folder: Path, size: int) -> None:
    write_checkpoint(folder / "checkpoint", size)


def _asset(folder: Path, size: int) -> None:
    from msb.adapters import export
    from msb.asset import write_asset

    _checkpoint(folder, size)
    write_asset(export(folder / "checkpoint"), folder / "mesh.triasset")


def _assets(folder: Path, size: int) -> None:
    for name in "ab":
        (folder / "all" / name).mkdir(parents=True)
        _asset(folder / "all" / name, size)


def _nothing(_folder: Path, _size: int) -> None:
    return


def _protocol(folder: Path, _size: int) -> None:
    (folder / "protocol.toml").write_bytes(protocol(folder, ("two_dts",), head="[videos]\nframes = 4").text)


def _results(folder: Path, _size: int) -> None:
    assert run_protocol(protocol(folder, ("two_dts",))).exit_status == 0


def _render(*more: object) -> Callable[[Path, Path], Sequence[object]]:
    line = ("render", "--turntable", 6, "--size", "320x240")
    return lambda _inputs, out: [*line, "-o", out / "images", *more, STUBS / "checkpoint"]


def _export(method: str) -> Callable[[Path, Path], Sequence[object]]:
    source = MODELS / "pebble" / method
    return lambda _inputs, out: ["export", source, out / f"{method}.triasset"]


COMMANDS = {
    command.name: command
    for command in (
        Command("export", lambda at, out: ["export", at / "checkpoint", out / "a.triasset"], _checkpoint),
        Command(
            "export-folder",
            lambda at, out: ["export", "--form", "folder", at / "checkpoint", out / "a.triasset"],
            _checkpoint,
        ),
        *(
            Command(f"export-{method}", _export(method), _nothing)
            for method in ("two_dts", "triangle_splatting", "diffsoup")
        ),
        Command("convert", lambda at, out: ["convert", at / "mesh.triasset", out / "a.glb"], _asset),
        Command("convert-ply", lambda at, out: ["convert", at / "mesh.triasset", out / "a.ply"], _asset),
        Command("convert-folder", lambda at, out: ["convert", at / "all", out / "meshes"], _assets),
        Command(
            "repair",
            lambda at, out: [
                *("repair", at / "mesh.triasset", "-o", out / "a.triasset"),
                *("--maps", out / "maps.npz"),
            ],
            _asset,
        ),
        Command(
            "repair-compare",
            lambda _at, out: [
                *("repair", "--compare", "--task", "intersections", STUBS / "checkpoint"),
                *("-o", out / "costs"),
            ],
            _nothing,
        ),
        Command(
            "trial",
            lambda _at, out: [
                "trial",
                "--task",
                "intersections",
                "--save",
                out / "kept",
                STUBS / "checkpoint",
            ],
            _nothing,
        ),
        Command(
            "why",
            lambda _at, out: [
                *("why", "--size", "64x48", STUBS / "checkpoint"),
                *("--save", out / "pictures", "--json", out / "why.json"),
            ],
            _nothing,
        ),
        Command(
            "audit",
            lambda at, out: [
                *("audit", at / "mesh.triasset", "--json", out / "a.json"),
                *("--csv", out / "a.csv", "--elements", out / "elements.csv"),
            ],
            _asset,
        ),
        Command("view", lambda at, out: ["view", at / "mesh.triasset", "--html", out / "a.html"], _asset),
        Command(
            "compare",
            lambda _at, out: ["compare", *QUICK_VIEWS, STUBS / "checkpoint", "--html", out / "a.html"],
            _nothing,
        ),
        Command("web", lambda at, out: ["web", at / "mesh.triasset", "-o", out / "a.html"], _asset),
        Command(
            "web-dedicated",
            lambda _at, out: [
                *("web", "--tier", "dedicated", "--no-verify", STUBS / "checkpoint"),
                *("-o", out / "a.html"),
            ],
            _nothing,
        ),
        Command("demo-data", lambda _at, out: ["demo-data", out / DEMO], _nothing),
        Command("render", _render(), _nothing),
        Command("render-npy", _render("--format", "npy", "--depth"), _nothing),
        Command(
            "film",
            lambda _at, out: ["render", "--turntable", 12, "--film", out / "a.mp4", STUBS / "checkpoint"],
            _nothing,
        ),
        Command(
            "run",
            lambda at, out: ["run", "-o", out / "results", at / "protocol.toml"],
            _protocol,
            force=False,
        ),
        Command("report", lambda at, out: ["report", at / "results", "-o", out / "report"], _results),
        Command(
            "compile",
            _render(),
            _nothing,
            environment=lambda folder: {"POCL_CACHE_DIR": str(folder / "cache")},
        ),
    )
}
"""`compile` renders on an empty cache of kernels: what a killed compiler leaves there must not matter."""
