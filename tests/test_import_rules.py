"""Who may import whom, and what of others. The tables below are the rule; the code is held to them."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # `make lint` runs them

ROOT = Path(__file__).parent.parent
GROUND = {"errors", "base", "registry", "asset", "scenes"}
"""NumPy and the standard library only; scenes reads the headers of photographs with Pillow."""
ALLOWED: dict[str, set[str]] = {
    "__main__": {"cli"},
    "__init__": GROUND | {"topology", "render", "repair", "trial", "adapters", "metrics", "api", "why"},
    "why": GROUND | {"adapters", "meshes", "metrics", "api", "render", "views"},
    # The verbs: from a path to what lies there, what is found of it, and back.
    "api": GROUND | {"meshes", "adapters", "topology"},
    "views": GROUND | {"adapters", "render"},
    "errors": set(),
    # The registry and what methods declare: how their code reads datasets is said with `scenes`.
    "registry": {"errors", "base", "scenes"},
    "methods": {"registry", "scenes"},
    "base": {"errors"},
    "asset": GROUND,
    # The verbs, as methods of an asset: they import `msb` when they are called, and name what it returns.
    "asset.asset": GROUND | {"msb", "topology", "repair", "render"},
    "scenes": GROUND,
    "meshes": GROUND,
    "adapters": GROUND | {"meshes"},
    "cl": {"errors", "base"},
    "topology": {"errors", "base", "cl"},
    "metrics": {"errors", "base", "meshes"},
    "render": GROUND | {"cl", "api"},
    "reference": GROUND,
    "engines": GROUND | {"render", "meshes"},
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
    },
    "repair": GROUND | {"api", "meshes", "topology", "metrics", "render"},
    # A trial can be of the repaired mesh.
    "trial": GROUND | {"api", "meshes", "topology", "metrics", "render", "repair", "views"},
    # What shows is below the commands that open it.
    "viewers": GROUND | {"api", "meshes", "topology", "metrics", "render", "cl"},
}
ANYTHING = {"cli"}
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
}
"""Imported inside the function that needs them, never when a module loads."""
FOREIGN: dict[str, set[str]] = {
    "scenes": {"numpy", "PIL"},
    "topology": {"numpy", "scipy", "igl", "pymeshlab", "manifold3d", "networkx", "trimesh"},
    "cl": {"numpy", "pyopencl"},
    "adapters": {"numpy", "yaml", "PIL"},
    "methods.adapter": {"numpy", "yaml", "PIL"},
    "methods.official": {"numpy", "PIL"},
    "render": {"numpy", "PIL", "OpenEXR", "av"},
    "metrics": {"numpy", "scipy", "skimage", "PIL", "OpenEXR", "torch"},
    "cli": {"numpy", "typer", "rich", "msb_viewers"},
    "viewers": {"numpy", "PIL", "pyvista", "vtkmodules", "matplotlib"},
    "bench": {"numpy", "scipy", "pydantic", "PIL", "filelock", "psutil", "pynvml", "distributed"},
    "engines": {"numpy", "wgpu", "bpy", "mathutils", "gpu", "OpenEXR", "PIL"},
    "trial": {"numpy", "scipy", "PIL", "trimesh", "igl", "pymeshlab", "manifold3d", "xatlas", "coacd"}
    | {"fast_simplification"},
    "report": {"pydantic", "PIL", "jinja2", "matplotlib"},
}
"""Third-party packages a part may use; the ground and everything not named here: numpy."""
DISTRIBUTIONS = {
    "PIL": "pillow",
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
OURS = {"msb", "msb_viewers"}
PEERS = {"igl", "pymeshlab", "manifold3d", "networkx"}
MODULES = sorted([*(ROOT / "msb").rglob("*.py"), *(ROOT / "viewers").rglob("*.py")])


def part_of(path: Path) -> str:
    if path.is_relative_to(ROOT / "viewers"):
        return "viewers"
    names = path.relative_to(ROOT / "msb").with_suffix("").parts
    return "asset.asset" if names == ("asset", "asset") else part_named(names)


def part_named(names: Sequence[str]) -> str:
    """Return the part of the module msb.NAMES; in a method's folder the role its name begins with."""
    in_folder = names[0] == "methods" and len(names) > 2 and (ROOT / "msb" / "methods" / names[1]).is_dir()
    return (
        f"methods.{names[2].partition('_')[0]}"
        if in_folder and names[2].islower() and names[2] != "__init__"
        else names[0]
    )


@cache
def imports_of(path: Path) -> list[tuple[str, bool]]:
    """Return every imported module and whether the import runs when the file is loaded."""
    tree = ast.parse(path.read_text())
    lazy_nodes: set[ast.AST] = set()
    typing_only: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lazy_nodes.update(ast.walk(node))
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            typing_only.update(ast.walk(node))
    found = []
    for node in ast.walk(tree):
        at_load = node not in lazy_nodes and node not in typing_only
        if isinstance(node, ast.Import):
            found += [(name.name, at_load) for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide which part is meant"
            module = node.module or ""
            # Of what is imported from a method's folder its role is asked, not the folder's.
            if module.startswith("msb.methods."):
                roles = [
                    f"{module}.{name.name}" if name.name != "METHOD" else "msb.registry"
                    for name in node.names
                ]
            else:
                roles = [f"msb.{name.name}" for name in node.names] if module == "msb" else [module]
            found += [(name, at_load) for name in roles]
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_what_its_part_may(path: Path) -> None:
    part = part_of(path)
    for name, at_load in imports_of(path):
        top, _, rest = name.partition(".")
        if top == "msb" and part not in ANYTHING:
            target = part_named(rest.split(".")) or "msb"
            if target != part:
                assert target in ALLOWED[part], f"{path}: {part} may not import msb.{target}"
                assert part != "asset.asset" or not at_load or target in GROUND, f"{path}: {name} at load"
        elif top == "msb_viewers" and part == "viewers":
            continue
        elif top != "msb" and top not in sys.stdlib_module_names:
            wanted = FOREIGN.get(part, {"numpy"})
            assert top in wanted, f"{path}: {part} may not import {top}"
            assert not (at_load and top in LAZY), f"{path}: import {top} inside the function that needs it"


def installed_by(requirements: list[str]) -> set[str]:
    """Return the names of distributions in `requirements`, as pyproject.toml writes them."""
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower() for line in requirements}


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CORE = installed_by(PROJECT["dependencies"])
EXTRAS = {name: installed_by(lines) for name, lines in PROJECT["optional-dependencies"].items()}


def others(path: Path) -> set[tuple[str, bool]]:
    """Return what pip has to install for the module, and whether it is needed when the module loads."""
    return {
        (DISTRIBUTIONS.get(top, top), at_load)
        for name, at_load in imports_of(path)
        if (top := name.partition(".")[0]) not in sys.stdlib_module_names | OURS
    }


def test_what_loads_with_a_module_is_a_core_dependency() -> None:
    needed = {name: path for path in MODULES for name, at_load in others(path) if at_load}
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


def test_rules_cover_every_part() -> None:
    assert {part_of(path) for path in MODULES} <= set(ALLOWED) | ANYTHING


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
        (HELP.format("view"), HEAVY | {"pyvista", "vtkmodules"}),
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
