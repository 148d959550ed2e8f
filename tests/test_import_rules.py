"""Who may import whom, and what of others. The tables below are the rule; the code is held to them."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Literal

import pytest

from tests.conftest import ROOT, of_the_whole

pytestmark = pytest.mark.slow  # `make lint` runs them

GROUND = {"errors", "base", "registry", "asset", "scenes"}
"""NumPy and the standard library only; scenes reads the headers of photographs with Pillow."""
ALLOWED: dict[str, set[str]] = {
    "__main__": {"cli"},
    # The kit of commands knows no capability; where it may look for one is a table of names.
    "cli": GROUND,
    "command_files": GROUND | {"cli", "api", "meshes"},
    "__init__": GROUND
    | {"topology", "render", "repair", "trial", "bake", "adapters", "metrics", "api", "why", "delivery"},
    "why": GROUND | {"adapters", "meshes", "metrics", "api", "render", "views"},
    # The verbs: from a path to what lies there, what is found of it, and back.
    "api": GROUND | {"meshes", "adapters", "topology"},
    # What is written of an asset: a file for the web is as coarse as pictures allow.
    "delivery": GROUND | {"meshes", "render", "views"},
    "views": GROUND | {"adapters", "meshes", "metrics", "render"},
    "errors": set(),
    # The registry and what methods declare: how their code reads datasets is said with `scenes`.
    "registry": {"errors", "base", "scenes"},
    "methods": {"registry", "scenes"},
    "base": {"errors"},
    "asset": GROUND,
    # The verbs, as methods of an asset: they import `msb` when they are called.
    "asset.asset": GROUND | {"msb"},
    "scenes": GROUND,
    "meshes": GROUND,
    "adapters": GROUND | {"meshes"},
    "cl": {"errors", "base"},
    "topology": {"errors", "base", "cl"},
    # Of scenes, how photographs are compared.
    "metrics": {"errors", "base", "meshes", "scenes"},
    "render": GROUND | {"cl", "api"},
    "reference": GROUND,
    "engines": GROUND | {"render", "meshes", "metrics"},
    # A method's folder, by role: what draws knows no checkpoint, the reference nothing that draws.
    "methods.adapter": GROUND | {"adapters", "meshes"},
    "methods.official": GROUND | {"adapters", "meshes", "methods.adapter"},
    "methods.reference": GROUND | {"reference"},
    "methods.look": GROUND | {"render", "cl"},
    # Of bench, the records and what follows from them; of metrics and topology, how numbers are printed.
    "report": {"errors", "base", "registry", "bench", "metrics", "topology"},
    "bench": GROUND
    | {
        "api",
        "meshes",
        "adapters",
        "topology",
        "metrics",
        "render",
        "reference",
        "engines",
        "cl",
        "repair",
        "trial",
        "bake",
    },
    "repair": GROUND | {"api", "meshes", "topology", "metrics", "render"},
    # A trial can be of the repaired mesh.
    "trial": GROUND | {"api", "meshes", "topology", "metrics", "render", "repair", "views"},
    "bake": GROUND
    | {
        "adapters",
        "api",
        "cl",
        "delivery",
        "engines",
        "meshes",
        "metrics",
        "render",
        "repair",
        "topology",
        "views",
    },
    # What shows is below the commands that open it.
    "viewers": GROUND | {"api", "meshes", "topology", "metrics", "render", "cl"},
}
KIT = {"cli", "api", "render", "command_files"}
"""What every command may import beside what its package may: the kit, opening files, options of drawing."""
COMMANDS: dict[str, set[str]] = {
    "repair": {"trial", "views", "delivery", "adapters"},
    "api": {"report", "viewers", "delivery"},
    "delivery": {"adapters"},
    "engines": {"views"},
    "viewers": {"views", "delivery"},
    "report": {"viewers"},
}
"""What the commands of a package may import beside that, when they are called."""
LAZY = {
    "torch",
    "PIL",
    "pyvista",
    "vtkmodules",
    "matplotlib",
    "msb_viewers",
    "igl",
    "pymeshlab",
    "manifold3d",
    "networkx",
    "dask",
    "distributed",
    "pynvml",
    "bpy",
    "mathutils",
    "gpu",
    "wgpu",
    "OpenEXR",
    "trimesh",
    "pyopencl",
    "xatlas",
    "fast_simplification",
    "coacd",
    "meshopt",
    "DracoPy",
    "pxr",
    "usd_validation_nvidia",
}
"""Imported inside the function that needs them, never when a module loads."""
FOREIGN: dict[str, set[str]] = {
    "scenes": {"numpy", "PIL"},
    "topology": {"numpy", "scipy", "igl", "pymeshlab", "manifold3d", "networkx", "trimesh"}
    | {"pxr", "usd_validation_nvidia"},
    "meshes": {"numpy", "PIL", "meshopt", "DracoPy", "pxr"},
    "cl": {"numpy", "pyopencl"},
    "adapters": {"numpy", "yaml", "PIL"},
    "methods.adapter": {"numpy", "yaml", "PIL"},
    "methods.official": {"numpy", "PIL"},
    "render": {"numpy", "PIL", "OpenEXR", "av"},
    "metrics": {"numpy", "scipy", "skimage", "PIL", "OpenEXR", "torch"},
    "cli": {"numpy", "typer", "rich", "msb_viewers"},
    "viewers": {"numpy", "PIL", "pyvista", "vtkmodules", "matplotlib"},
    "bench": {"numpy", "scipy", "pydantic", "PIL", "filelock", "psutil", "pynvml", "distributed"},
    "bake": {"numpy", "scipy", "skimage", "fast_simplification", "xatlas", "coacd"},
    "engines": {"numpy", "wgpu", "bpy", "mathutils", "gpu", "OpenEXR", "PIL"},
    "trial": {"numpy", "scipy", "PIL", "trimesh", "igl", "pymeshlab", "manifold3d", "xatlas", "coacd"}
    | {"fast_simplification"},
    "report": {"pydantic", "PIL", "jinja2", "matplotlib"},
}
"""Third-party packages a part may use; the ground and everything not named here: numpy."""
DISTRIBUTIONS = {
    "PIL": "pillow",
    "DracoPy": "dracopy",
    "pxr": "usd-core",
    "usd_validation_nvidia": "usd-validation-nvidia",
    "yaml": "pyyaml",
    "skimage": "scikit-image",
    "OpenEXR": "openexr",
    "igl": "libigl",
    "vtkmodules": "pyvista",  # which depends on vtk
    "distributed": "dask",
    "fast_simplification": "fast-simplification",
    "pynvml": "nvidia-ml-py",
    "mathutils": "bpy",
    "gpu": "bpy",
}
"""Module -> what pip installs it by, where the two differ."""
When = Literal["loaded", "called", "never"]
"""When an import runs: with its module, with a function, or for types alone."""
OURS = {"msb", "msb_viewers"}
LOADS_NOTHING = {"msb_viewers.options"}
"""Options that the help of a command names."""
PEERS = {"igl", "pymeshlab", "manifold3d", "networkx", "usd_validation_nvidia"}
MODULES = sorted([*(ROOT / "msb").rglob("*.py"), *(ROOT / "viewers").rglob("*.py")])


def part_of(path: Path) -> str:
    if path.is_relative_to(ROOT / "viewers"):
        return "viewers.command" if "commands" in path.parts else "viewers"
    names = path.relative_to(ROOT / "msb").with_suffix("").parts
    return "asset.asset" if names == ("asset", "asset") else part_named(names)


def part_named(names: Sequence[str]) -> str:
    """Return the part of the module msb.NAMES; in a method's folder the role its name begins with."""
    in_folder = names[0] == "methods" and len(names) > 2 and (ROOT / "msb" / "methods" / names[1]).is_dir()
    if in_folder and names[2].islower() and names[2] != "__init__":
        return f"methods.{names[2].partition('_')[0]}"
    if names[0:2] == ("api", "command_files"):
        return "command_files"
    if names[0] == "cli":
        return "cli"
    return f"{names[0]}.command" if names[1:2] in (("command",), ("commands",)) else names[0]


@cache
def imports_of(path: Path) -> list[tuple[str, When]]:
    """Return every imported module and when the import runs, if it does."""
    tree = ast.parse(path.read_text())
    when: dict[ast.AST, When] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            when.update(dict.fromkeys(ast.walk(node), "called"))
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            when.update(dict.fromkeys(ast.walk(node), "never"))
    found: list[tuple[str, When]] = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide which part is meant"
            module = node.module or ""
            folder = ROOT / module.replace(".", "/")
            # In a method's folder the role of a module counts; the folder itself declares data.
            if module.startswith("msb.methods."):
                roles = {path.stem for path in folder.glob("*.py")} if folder.is_dir() else None
                names = [
                    f"{module}.{name.name}" if roles is None or name.name in roles else "msb.registry"
                    for name in node.names
                ]
            else:
                names = [f"msb.{name.name}" for name in node.names] if module == "msb" else [module]
        found += [(name, when.get(node, "loaded")) for name in names]
    return found


def allowed(part: str) -> set[str]:
    """Return what a part may import of ours; its commands may import more."""
    package = part.removesuffix(".command")
    if package == part:
        return ALLOWED[part]
    return ALLOWED[package] | KIT | {package} | COMMANDS.get(package, set())


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_what_its_part_may(path: Path) -> None:
    part = part_of(path)
    for name, when in imports_of(path):
        top, _, rest = name.partition(".")
        if top == "msb":
            target = part_named(tuple(rest.split("."))) or "msb"
            assert not target.endswith(".command") or target == part, f"{path}: a command is its own"
            if target != part:
                assert target in allowed(part), f"{path}: {part} may not import msb.{target}"
                assert target != "msb" or when != "loaded", f"{path}: {name} at load"
        elif top == "msb_viewers" and part.startswith("viewers"):
            continue
        elif top not in sys.stdlib_module_names:
            wanted = FOREIGN.get(part) or FOREIGN.get(part.removesuffix(".command"), set()) | {"numpy"}
            wanted = wanted | ({"typer", "rich", "msb_viewers"} if part.endswith(".command") else set())
            assert top in wanted, f"{path}: {part} may not import {top}"
            assert when != "loaded" or top not in LAZY or name in LOADS_NOTHING, (
                f"{path}: import {top} inside the function that needs it"
            )


def installed_by(requirements: list[str]) -> set[str]:
    """Return the names of distributions in `requirements`, as pyproject.toml writes them."""
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower() for line in requirements}


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CORE = installed_by(PROJECT["dependencies"])
EXTRAS = {name: installed_by(lines) for name, lines in PROJECT["optional-dependencies"].items()}


def others(path: Path) -> set[tuple[str, When]]:
    """Return what pip has to install for the module, and when it is needed."""
    return {
        (DISTRIBUTIONS.get(top, top), when)
        for name, when in imports_of(path)
        if (top := name.partition(".")[0]) not in sys.stdlib_module_names | OURS
    }


def test_what_loads_with_a_module_is_a_core_dependency() -> None:
    needed = {name: path for path in MODULES for name, when in others(path) if when == "loaded"}
    assert {name: path for name, path in needed.items() if name not in CORE} == {}


def test_what_is_imported_is_installed_by_the_core_or_an_extra_that_is_asked_for() -> None:
    used = {name for path in MODULES for name, _ in others(path)}
    known = CORE.union(*(EXTRAS[name] for name in EXTRAS if name not in ("test", "fuzz", "all", "docs")))
    assert used - known == set()


def test_the_core_installs_nothing_that_only_runs_reports_and_viewers_use() -> None:
    parts = [path for path in MODULES if part_of(path) not in ("bench", "report", "viewers")]
    used = {name for path in parts for name, _ in others(path)}
    # PoCL's wheel holds no module, and typer depends on pydantic anyway.
    assert CORE - used == {"pocl-binary-distribution", "pydantic"}


@of_the_whole
def test_an_error_about_an_extra_names_the_one_that_installs_the_module() -> None:
    asked = set()
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("need_extra", "install"):
                words = [str(a.value) for a in node.args if isinstance(a, ast.Constant)]
                for extra in words[:1]:  # none in the function that is called itself
                    asked.add(extra)
                    installed = EXTRAS[extra] | OURS
                    assert {DISTRIBUTIONS.get(word, word) for word in words[1:]} <= installed, path
    # Those that only a checkout uses are asked for by nothing in the package.
    assert asked == set(EXTRAS) - {"all", "test", "fuzz", "train", "docs"}


def test_all_is_every_extra_but_those_for_developers_and_the_largest() -> None:
    (line,) = PROJECT["optional-dependencies"]["all"]
    named = line.partition("[")[2].rstrip("]").split(",")
    assert set(named) == set(EXTRAS) - {"all", "blender", "intel", "train", "docs", "fuzz", "test"}


def test_only_cross_checks_and_trials_know_the_peers() -> None:
    users = {
        path.relative_to(ROOT / "msb").as_posix()
        for path in MODULES
        if any(name.partition(".")[0] in PEERS for name, _ in imports_of(path))
    }
    assert users
    assert all(user.startswith(("topology/crosscheck", "trial")) for user in users)


def test_what_draws_opens_no_path_but_at_its_front_door() -> None:
    drawing = [path for path in MODULES if part_of(path) == "render"]
    users = [path.name for path in drawing if any(name == "msb.api.opening" for name, _ in imports_of(path))]
    assert users == ["renderer.py"]


FOLDERS = ("msb", "viewers", "data_stubs", "benchmarks", "fuzz", "tools")
ROOMS = {path.stem for path in (ROOT / "msb").iterdir()} - {"__init__"}


def room(names: Sequence[str]) -> str | None:
    """Return the room of a module: a package or module of msb/, the viewers or another folder of ours."""
    if "cli" not in names and {"command", "commands", "command_files"} & set(names):
        return "commands"  # they stand above all rooms
    if names[0] == "msb":
        return names[1] if len(names) > 1 and names[1] in ROOMS else None  # who comes in by the front
    return "viewers" if names[0] == "msb_viewers" else names[0] if names[0] in FOLDERS else None


def arrows() -> set[tuple[str, str, When]]:
    """Return which room imports which other, and when."""
    return {
        (here, there, when)
        for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
        for name, when in imports_of(path)
        if (here := room(path.relative_to(ROOT).with_suffix("").parts))
        and (there := room(name.split(".")))
        and here != there
    }


def test_no_import_runs_up() -> None:
    """Rooms can be put in an order in which each imports those below it, whenever the import runs."""
    below: dict[str, set[str]] = {}
    for here, there, when in arrows():
        if when != "never":
            below.setdefault(here, set()).add(there)
    assert [*TopologicalSorter(below).static_order()][-1] in (*FOLDERS, "commands")  # or it raises CycleError


def test_rules_cover_every_part() -> None:
    assert {part_of(path).removesuffix(".command") for path in MODULES} <= set(ALLOWED)


HELP = (
    "import sys; sys.argv = ['msb', {!r}, '--help']\nfrom msb.cli import main\n"
    "try:\n    main()\nexcept SystemExit as stop:\n    assert stop.code == 0\n"
)
HEAVY = {"numpy", "scipy", "pyopencl", "trimesh", "rich"}
PEERS_AND_MORE = {"torch", "trimesh", "igl", "pymeshlab", "networkx", "pyopencl", "skimage"}


@pytest.mark.parametrize(
    ("code", "spared"),
    [
        ("import msb", HEAVY | {"typer"}),
        (HELP.format("audit"), HEAVY),
        pytest.param(HELP.format("view"), HEAVY | {"pyvista", "vtkmodules"}, marks=of_the_whole),
        ("import msb; msb.audit(msb.load('data_stubs/splat_like.triasset'))", PEERS_AND_MORE),
    ],
    ids=["import", "help", "help of view", "audit"],
)
def test_nothing_is_loaded_that_is_not_needed(code: str, spared: set[str]) -> None:
    show = "\nimport sys; print(*{name.partition('.')[0] for name in sys.modules})"
    path = os.pathsep.join((str(ROOT), str(ROOT / "viewers")))
    done = subprocess.run(
        [sys.executable, "-c", code + show],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path},
    )
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "msb" in loaded
    assert not spared & loaded


if __name__ == "__main__":  # python -m tests.test_import_rules
    pairs = {(here, there) for here, there, _ in arrows()}
    print(f"{len({each for pair in pairs for each in pair})} rooms, {len(pairs)} arrows between them")
