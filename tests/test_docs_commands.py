"""Run all commands and Python code of the pages in docs/, with shipped data in place of the reader's files.

README and guides do not name files of the reader. tests/test_guides.py runs them. A ``console`` block has one
command per line. If some lines of a block start with $, only these lines are commands, and the other lines
are output. The commands of a document run one after the other, in the same process and folder. Commands that
need an extra run separately, together with those of other documents with the same need.
"""

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer.main

import msb
from msb.cli.app import app
from msb.render.backend import why_unavailable
from tests.conftest import ROOT, shorten
from tests.splats import builders
from tests.tiny import link_demo, write_chair

pytestmark = pytest.mark.slow

DOCUMENTS = sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))
SCENE = ROOT / "tests" / "tiny" / "scenes" / "mipnerf360" / "pebble"
MODEL = ROOT / "tests" / "tiny" / "models" / "walled" / "mesh_splatting"
TWO_DTS = ROOT / "tests" / "tiny" / "models" / "walled" / "two_dts"

NOT_RUN = {
    r"(pip|python3\S*|dask|export) ": "installs or starts other programs",
    r"msb view (?!.*--(screenshot|figure|html) )": "opens a window",
    r"msb-audit .*--view ": "opens a window",
    r"msb trial (?!.*--task )": "takes minutes; tests/trial runs every task",
    r"msb repair --compare ": "takes minutes; a shorter one is an example of --help, which is run",
    r"msb bake --(for-solid|scene) ": "takes minutes; it is an example of --help, which is run",
    r"msb bake scene.compressed.ply ": "takes minutes; tests/bake bakes Gaussians",
    r"msb score (?!.*--pose capture)": "takes a minute; tests/score find poses",
    r"msb run --scheduler ": "needs a cluster; tests/bench/test_interruption.py starts one",
}
"""Patterns of commands that are not run, with the reason. Options of our commands are at least parsed."""
NEEDS = {
    r"msb view .*--(screenshot|figure)": "view",
    r"msb-audit .*--cross-check": "crosscheck",
    r"msb trial .*--task uv": "trial",
    r"msb render .*--renderer wgpu": "wgpu",
    r"msb bench .*--renderer threejs": "threejs",
    r"msb web .*--(tier dedicated|verify)": "threejs",
}
"""Patterns of commands that need more than the core, with the extra or renderer (see `msb devices`) that they
need.
"""
PYTHON_NOT_RUN = {"docs/metrics.md": "it needs images, weights and scans of the reader"}
PEERS = {"view": "pyvista", "crosscheck": "pymeshlab", "trial": "xatlas"}
"""A module that each extra installs."""

DRIVER = """
import json, sys
from msb.cli import main, main_audit
for words in json.loads(sys.stdin.read()):
    print("$", *words, flush=True)
    sys.argv = words
    try:
        {"msb": main, "msb-audit": main_audit}[words[0]]()
    except SystemExit as end:
        if end.code:
            sys.exit(f"{' '.join(words)} ended with {end.code}")
"""

PROTOCOL = """
results = "out/demo/results"
timing = { frames = 0 }
datasets = [{ name = "mipnerf360", path = "360_v2" }]
methods = [
  { name = "two_dts", model = "output/2dts/{scene}", conditions = ["standard"] },
  { name = "mesh_splatting", model = "output/{scene}", conditions = ["dedicated", "standard"] },
]
"""


def blocks(document: str, language: str) -> list[str]:
    """Return the fenced blocks of `document` that are marked as `language`."""
    text = (ROOT / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(document: str) -> Iterator[str]:
    """Yield the commands of a document without comments."""
    for block in blocks(document, "console"):
        lines = block.splitlines()
        if any(line.startswith("$ ") for line in lines):
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        for line in lines:
            if words := shlex.split(line, comments=True):
                yield shlex.join(words)


def look_up(table: dict[str, str], command: str) -> str | None:
    return next((value for pattern, value in table.items() if re.match(pattern, command)), None)


def cases() -> dict[str, list[str]]:
    """Return the commands of each document, and the commands that need each extra or renderer.

    Repeated commands run once.
    """
    seen: set[str] = set()
    by_document: dict[str, list[str]] = {}
    for document in DOCUMENTS:
        for command in commands(document):
            if command not in seen and look_up(NOT_RUN, command) is None:
                by_document.setdefault(look_up(NEEDS, command) or document, []).append(command)
            seen.add(command)
    return by_document


def skip_without(need: str) -> None:
    if need in PEERS:
        if importlib.util.find_spec(PEERS[need]) is None:
            pytest.skip(f"extra {need} is not installed")
    elif (missing := why_unavailable(need)) is not None:
        pytest.skip(f"renderer {need}: {missing}")


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all files that the documents name."""
    folder = tmp_path_factory.mktemp("documents")
    links = {
        "tests": ROOT / "tests",
        **dict.fromkeys(("garden", "data/garden", "360_v2/garden"), SCENE),
        **dict.fromkeys(("images_4", "renders"), SCENE / "images_4"),
        "output/garden": MODEL,
        **dict.fromkeys(("output/2dts/garden", "outputs/chair"), TWO_DTS),
        "results/01_mip360/garden": MODEL.parent / "diffsoup",
        "config/mesh.yaml": TWO_DTS / "config.yaml",
    }
    for name, target in links.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).symlink_to(target)
    link_demo(folder)
    write_chair(folder)
    asset = msb.export(MODEL)
    assets = ("garden.triasset", "asset.triasset", "exports/garden.triasset")
    for name in (*assets, "mesh.ply", "scan.obj", "soup.stl"):
        (folder / name).parent.mkdir(exist_ok=True)
        msb.save(asset, folder / name)
    (folder / "scene.spz").write_bytes(builders.spz(builders.gaussians()))
    (folder / "train.py").write_text("print('trained')\n")
    (folder / "protocol.toml").write_text(PROTOCOL)
    pytest.importorskip("msb.bench", reason="msb.bench was removed")
    from msb.bench.protocol import read_protocol
    from msb.bench.run import run_protocol

    assert run_protocol(read_protocol(folder / "protocol.toml")).exit_status == 0
    for name in ("RESULTS", "first/results", "second/results"):
        shutil.copytree(folder / "out" / "demo" / "results", folder / name)
    return folder


@pytest.mark.parametrize(("document", "lines"), cases().items(), ids=cases())
def test_every_command_runs(document: str, lines: list[str], stand_ins: Path, tmp_path: Path) -> None:
    if document not in DOCUMENTS:
        skip_without(document)
    shutil.copytree(stand_ins, tmp_path, symlinks=True, dirs_exist_ok=True)
    if document == "threejs":  # software rendering of the browser lacks 16 samples per pixel
        (tmp_path / "garden.triasset").unlink()
        msb.save(msb.export(TWO_DTS), tmp_path / "garden.triasset")
    for line in lines:
        if line.startswith("msb export "):  # the command writes this file itself
            (tmp_path / shlex.split(line)[-1]).unlink(missing_ok=True)
    paths = [str(ROOT), str(ROOT / "viewers")]
    if document == "docs/extending.md":
        site = install_example(document, tmp_path / "site")
        paths.append(str(site))
        shutil.copy(site / "facets.toml", tmp_path)
        subprocess.run([sys.executable, site / "make_facets.py"], cwd=tmp_path, check=True)
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        input=json.dumps([shorten(shlex.split(line)) for line in lines]),
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(paths),
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        },
        timeout=300,
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    assert done.stdout.count("\n$ ") + 1 >= len(lines)
    if document == "docs/extending.md":
        report = tmp_path / "out" / "facets-report"
        pages = [path.read_text() for path in report.glob("*.html")]
        assert all(any(name in page for page in pages) for name in ("Facets", "Edges ↓"))


@pytest.mark.parametrize(
    "document", [name for name in DOCUMENTS if blocks(name, "python") and name not in PYTHON_NOT_RUN]
)
def test_python_runs(document: str, stand_ins: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(stand_ins, tmp_path, symlinks=True, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks(document, "python")), document, "exec"), {"__name__": "shown"})


def install_example(document: str, site: Path) -> Path:
    """Install the packages shown in `document` into the folder `site`, like pip. Return the folder.

    The line before a code block names its file. The pyproject.toml is the last file of each package.
    """
    text = (ROOT / document).read_text(encoding="utf-8")
    for name, block in re.findall(
        r"`([\w/.]+)`[^`\n]*:\n\n```\w+\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(block)
        if name != "pyproject.toml":
            continue
        project = tomllib.loads(block)["project"]
        info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
        groups = [
            f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
            for group, entries in project["entry-points"].items()
        ]
        (info / "entry_points.txt").write_text("".join(groups))
    return site


def test_options_of_commands_that_are_not_run_exist() -> None:
    every = [command for document in DOCUMENTS for command in commands(document)]
    ours = [command for command in every if command.startswith("msb ") and look_up(NOT_RUN, command)]
    assert ours
    root = typer.main.get_command(app)
    for command in ours:
        _, name, *words = shlex.split(command)
        subcommand = root.get_command(typer.Context(root), name)
        subcommand.make_context(name, words).close()


@pytest.mark.parametrize("pattern", [*NOT_RUN, *NEEDS])
def test_every_pattern_matches_a_command(pattern: str) -> None:
    assert any(re.match(pattern, command) for document in DOCUMENTS for command in commands(document))


def test_shell_commands_are_in_console_blocks() -> None:
    for document in DOCUMENTS:
        for block in blocks(document, ""):
            assert not re.match(r"(msb|msb-audit|pip|make|\$) ", block), f"{document}: {block}"
