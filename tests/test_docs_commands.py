"""All commands and Python that docs show are run; shipped data stands in for placeholders.

README and guides, which need no stand-ins, are run by tests/test_guides.py.

What is shown as ``console`` is a command a line, or, where a line starts with $, commands and what they
print. A document's commands run one after the other, in one process, in a folder of their own; those of all
documents that need the same extra, together.
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
from msb.render.backend import what_is_missing
from tests.conftest import ROOT, shortened
from tests.tiny import link_demo

pytestmark = pytest.mark.slow

DOCUMENTS = sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))
SCENE = ROOT / "tests" / "tiny" / "scenes" / "mipnerf360" / "pebble"
MODEL = ROOT / "tests" / "tiny" / "models" / "walled" / "mesh_splatting"
TWO_DTS = ROOT / "tests" / "tiny" / "models" / "walled" / "two_dts"

NOT_RUN = {
    r"(pip|python3\S*|dask|export) ": "installs or starts something that is not ours",
    r"msb view (?!.*--(screenshot|figure|html) )": "opens a window",
    r"msb trial (?!.*--task )": "takes minutes; tests/trial tries every task",
    r"msb repair --compare ": "takes long; with one task it is an example of --help, which are run, too",
    r"msb bake --(for-solid|scene) ": "takes long; the same is an example of --help, which are run, too",
    r"msb run --scheduler ": "needs a cluster; tests/bench/test_interruption.py has one",
}
"""Commands that are not run, and why. Of ours at least the options are parsed."""
NEEDS = {
    r"msb view .*--(screenshot|figure)": "view",
    r"msb-audit .*--cross-check": "crosscheck",
    r"msb trial .*--task uv": "trial",
    r"msb render .*--renderer wgpu": "wgpu",
    r"msb bench .*--renderer threejs": "threejs",
    r"msb web .*--(tier dedicated|verify)": "threejs",
}
"""Commands that need more than the core: an extra, or a renderer that `msb devices` says is missing."""
PYTHON_NOT_RUN = {"docs/metrics.md": "it scores images, weights and scans of the reader's"}
PEERS = {"view": "pyvista", "crosscheck": "pymeshlab", "trial": "xatlas"}

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
    """Yield what a reader would type, comments left out."""
    for block in blocks(document, "console"):
        lines = block.splitlines()
        if any(line.startswith("$ ") for line in lines):
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        for line in lines:
            if words := shlex.split(line, comments=True):
                yield shlex.join(words)


def first(table: dict[str, str], command: str) -> str | None:
    return next((value for pattern, value in table.items() if re.match(pattern, command)), None)


def cases() -> dict[str, list[str]]:
    """Return what to run by document or need, each command where it is shown first."""
    seen: set[str] = set()
    found: dict[str, list[str]] = {}
    for document in DOCUMENTS:
        for command in commands(document):
            if command not in seen and first(NOT_RUN, command) is None:
                found.setdefault(first(NEEDS, command) or document, []).append(command)
            seen.add(command)
    return found


def skip_without(need: str) -> None:
    if need in PEERS:
        if importlib.util.find_spec(PEERS[need]) is None:
            pytest.skip(f"extra {need} is not installed")
    elif (missing := what_is_missing(need)) is not None:
        pytest.skip(f"renderer {need}: {missing}")


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which everything exists that the documents name."""
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
    asset = msb.export(MODEL)
    assets = ("garden.triasset", "asset.triasset", "exports/garden.triasset")
    for name in (*assets, "mesh.ply", "scan.obj", "soup.stl"):
        (folder / name).parent.mkdir(exist_ok=True)
        msb.save(asset, folder / name)
    (folder / "train.py").write_text("print('trained')\n")
    (folder / "protocol.toml").write_text(PROTOCOL)
    pytest.importorskip("msb.bench", reason="msb.bench was removed")
    from msb.bench.protocol import read_protocol
    from msb.bench.run import run_protocol

    assert run_protocol(read_protocol(folder / "protocol.toml")).exit_status == 0
    for name in ("RESULTS", "first/results", "second/results"):
        shutil.copytree(folder / "out" / "demo" / "results", folder / name)
    return folder


@pytest.mark.parametrize(("shown", "lines"), cases().items(), ids=cases())
def test_every_command_runs(shown: str, lines: list[str], stand_ins: Path, tmp_path: Path) -> None:
    if shown not in DOCUMENTS:
        skip_without(shown)
    shutil.copytree(stand_ins, tmp_path, symlinks=True, dirs_exist_ok=True)
    if shown == "threejs":  # what the browser draws in software has no sixteen samples a pixel
        (tmp_path / "garden.triasset").unlink()
        msb.save(msb.export(TWO_DTS), tmp_path / "garden.triasset")
    for line in lines:
        if line.startswith("msb export "):  # it writes what else would stand in for it
            (tmp_path / shlex.split(line)[-1]).unlink(missing_ok=True)
    paths = [str(ROOT), str(ROOT / "viewers")]
    if shown == "docs/extending.md":
        site = installed(shown, tmp_path / "site")
        paths.append(str(site))
        shutil.copy(site / "facets.toml", tmp_path)
        subprocess.run([sys.executable, site / "make_facets.py"], cwd=tmp_path, check=True)
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        input=json.dumps([shortened(shlex.split(line)) for line in lines]),
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
    if shown == "docs/extending.md":
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


def installed(document: str, site: Path) -> Path:
    """Return a folder that holds the packages of `document` as pip would have installed them.

    A block is the file that the line before it names; a pyproject.toml ends the files of a package.
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
    shown = [command for document in DOCUMENTS for command in commands(document)]
    ours = [command for command in shown if command.startswith("msb ") and first(NOT_RUN, command)]
    assert ours
    known = typer.main.get_command(app)
    for command in ours:
        _, name, *words = shlex.split(command)
        found = known.get_command(typer.Context(known), name)
        found.make_context(name, words).close()


@pytest.mark.parametrize("pattern", [*NOT_RUN, *NEEDS])
def test_every_exception_is_of_use(pattern: str) -> None:
    assert any(re.match(pattern, command) for document in DOCUMENTS for command in commands(document))


def test_shell_commands_are_marked_as_such() -> None:
    for document in DOCUMENTS:
        for block in blocks(document, ""):
            assert not re.match(r"(msb|msb-audit|pip|make|\$) ", block), f"{document}: {block}"
