"""Rules for imports between our packages, and for imports of third-party packages.

The tables below define the rules.
"""

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
"""Packages that need only NumPy and the standard library. scenes also reads image headers with Pillow."""
ALLOWED: dict[str, set[str]] = {
    "__main__": {"cli"},
    # The command kit imports no capability. The command kit finds commands through a table of names.
    "cli": GROUND,
    "command_files": GROUND | {"cli", "api", "meshes"},
    "__init__": GROUND
    | {"topology", "render", "repair", "trial", "bake", "lod", "adapters", "metrics", "api", "why"}
    | {"delivery", "score"},
    "why": GROUND | {"adapters", "meshes", "metrics", "api", "render", "views"},
    "score": GROUND | {"meshes", "metrics", "api", "render", "topology"},
    # Opening files, auditing assets, and writing files.
    "api": GROUND | {"meshes", "adapters", "topology"},
    # Writing files for the web. The precision of such files is chosen by renderings.
    "delivery": GROUND | {"adapters", "api", "meshes", "render", "topology", "views"},
    "views": GROUND | {"adapters", "meshes", "metrics", "render"},
    "errors": set(),
    # The registry and the declarations of methods, which use `scenes` to declare how datasets are read.
    "registry": {"errors", "base", "scenes"},
    "methods": {"errors", "registry", "scenes"},
    "base": {"errors"},
    "asset": GROUND,
    # Some methods of an asset call functions of `msb`. These methods import `msb` when they are called.
    "asset.asset": GROUND | {"msb"},
    "scenes": GROUND,
    "meshes": GROUND,
    # Decodes bytes and arrays of splat files, and the Gaussians of an asset; opens no files.
    "splats": GROUND,
    "adapters": GROUND | {"meshes"},
    "cl": {"errors", "base"},
    "topology": {"errors", "base", "cl"},
    # metrics uses the rules of scenes for the comparison of photographs.
    "metrics": {"errors", "base", "meshes", "scenes"},
    "render": GROUND | {"cl", "api"},
    "reference": GROUND,
    "engines": GROUND | {"render", "meshes", "metrics"},
    # The folder of a method, by role. Renderers do not import checkpoints, and the reference does not import
    # renderers.
    "methods.adapter": GROUND | {"adapters", "meshes", "splats"},
    "methods.official": GROUND | {"adapters", "meshes", "splats", "methods.adapter"},
    "methods.reference": GROUND | {"reference", "splats"},
    "methods.native": GROUND | {"render", "cl", "splats"},
    # report uses records and derived numbers of bench, and number formats of metrics and topology.
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
    # A trial can test a repaired mesh.
    "trial": GROUND | {"api", "meshes", "topology", "metrics", "render", "repair", "views"},
    "lod": GROUND | {"adapters", "api", "delivery", "meshes", "render", "topology", "views"},
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
    # Commands that open viewers may import the viewers.
    "viewers": GROUND | {"api", "meshes", "topology", "metrics", "render", "cl", "views"},
}
KIT = {"cli", "api", "render", "command_files"}
"""Packages that every command may import in addition.

These packages parse arguments, open files and choose renderers.
"""
COMMANDS: dict[str, set[str]] = {
    "repair": {"trial", "views", "delivery", "adapters"},
    "score": {"trial"},
    "bake": {"adapters", "lod"},
    "scenes": {"metrics"},
    "api": {"report", "viewers", "delivery"},
    "engines": {"views"},
    "viewers": {"delivery"},
    "report": {"viewers"},
}
"""Further packages that the commands of a package may import when they are called."""
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
    "almeshopt",
    "vhacdx",
    "DracoPy",
    "pxr",
    "usd_validation_nvidia",
    "zstandard",
    "cv2",
    "pycolmap",
}
"""Packages that are imported inside functions only, never when a module loads."""
FOREIGN: dict[str, set[str]] = {
    "scenes": {"numpy", "scipy", "PIL", "cv2", "pycolmap"},
    "topology": {"numpy", "scipy", "igl", "pymeshlab", "manifold3d", "networkx", "trimesh"}
    | {"pxr", "usd_validation_nvidia"},
    "meshes": {"numpy", "PIL", "meshopt", "DracoPy", "pxr"},
    "splats": {"numpy", "zstandard"},
    "cl": {"numpy", "pyopencl"},
    "adapters": {"numpy", "yaml", "PIL"},
    "methods.adapter": {"numpy", "yaml", "PIL"},
    "methods.official": {"numpy", "PIL"},
    "render": {"numpy", "PIL", "OpenEXR", "av"},
    "metrics": {"numpy", "scipy", "skimage", "PIL", "OpenEXR", "torch"},
    "__init__": {"msb_viewers"},
    "cli": {"numpy", "typer", "rich", "msb_viewers"},
    "viewers": {"numpy", "PIL", "pyvista", "vtkmodules", "matplotlib"},
    "bench": {"numpy", "scipy", "pydantic", "PIL", "filelock", "psutil", "pynvml", "distributed"},
    "score": {"numpy", "scipy", "PIL", "cv2"},
    "bake": {"numpy", "scipy", "skimage", "fast_simplification", "xatlas"},
    "delivery": {"numpy", "scipy", "coacd", "vhacdx"},
    "lod": {"numpy", "PIL", "almeshopt", "pxr"},
    "engines": {"numpy", "wgpu", "bpy", "mathutils", "gpu", "OpenEXR", "PIL"},
    "trial": {"numpy", "scipy", "PIL", "trimesh", "igl", "pymeshlab", "manifold3d", "xatlas", "coacd"}
    | {"fast_simplification"},
    "report": {"pydantic", "PIL", "jinja2", "matplotlib"},
}
"""The allowed third-party packages of each part. Parts that are not listed may only use numpy."""
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
    "cv2": "opencv-python-headless",
}
"""Names of the pip packages of modules, if they differ."""
When = Literal["loaded", "called", "never"]
"""When an import runs: when its module is loaded, when a function is called, or never (for type checks)."""
OURS = {"msb", "msb_viewers"}
LOADS_NOTHING = {"msb_viewers.options"}
"""Modules of the viewers that modules of msb may import when they load: options for the help of commands."""
PEERS = {"igl", "pymeshlab", "manifold3d", "networkx", "usd_validation_nvidia"}
MODULES = sorted([*(ROOT / "msb").rglob("*.py"), *(ROOT / "viewers").rglob("*.py")])


def part_of(path: Path) -> str:
    if path.is_relative_to(ROOT / "viewers"):
        return "viewers.command" if "commands" in path.parts else "viewers"
    names = path.relative_to(ROOT / "msb").with_suffix("").parts
    return "asset.asset" if names == ("asset", "asset") else part_named(names)


def part_named(names: Sequence[str]) -> str:
    """Return the part of the module msb.NAMES.

    The part of a module of a method is its role, which its file name gives.
    """
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
    """Return the imported modules of a file, each with the time at which the import runs."""
    tree = ast.parse(path.read_text())
    when: dict[ast.AST, When] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            when.update(dict.fromkeys(ast.walk(node), "called"))
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            when.update(dict.fromkeys(ast.walk(node), "never"))
    imports: list[tuple[str, When]] = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide which part is meant"
            module = node.module or ""
            folder = ROOT / module.replace(".", "/")
            # For modules of a method the role counts. The package itself only declares data.
            if module.startswith("msb.methods."):
                roles = {path.stem for path in folder.glob("*.py")} if folder.is_dir() else None
                names = [
                    f"{module}.{name.name}" if roles is None or name.name in roles else "msb.registry"
                    for name in node.names
                ]
            else:
                names = [f"msb.{name.name}" for name in node.names] if module == "msb" else [module]
        imports += [(name, when.get(node, "loaded")) for name in names]
    return imports


def allowed_packages(part: str) -> set[str]:
    """Return our packages that a part may import.

    Commands may import more than the other modules of their package.
    """
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
            assert not target.endswith(".command") or target == part, f"{path}: commands must not be imported"
            if target != part:
                assert target in allowed_packages(part), f"{path}: {part} may not import msb.{target}"
                assert target != "msb" or when != "loaded", f"{path}: {name} at load"
        elif top == "msb_viewers" and part.startswith("viewers"):
            continue
        elif top not in sys.stdlib_module_names:
            allowed_names = FOREIGN.get(part) or FOREIGN.get(part.removesuffix(".command"), set()) | {"numpy"}
            allowed_names = allowed_names | (
                {"typer", "rich", "msb_viewers"} if part.endswith(".command") else set()
            )
            assert top in allowed_names, f"{path}: {part} may not import {top}"
            assert when != "loaded" or top not in LAZY or name in LOADS_NOTHING, (
                f"{path}: import {top} inside the function that needs it"
            )


def distribution_names(requirements: list[str]) -> set[str]:
    """Return the names of distributions in `requirements`, in the spelling of pyproject.toml."""
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower() for line in requirements}


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CORE = distribution_names(PROJECT["dependencies"])
EXTRAS = {name: distribution_names(lines) for name, lines in PROJECT["optional-dependencies"].items()}


def pip_packages(path: Path) -> set[tuple[str, When]]:
    """Return the pip packages that a module needs, and the time at which it imports them."""
    return {
        (DISTRIBUTIONS.get(top, top), when)
        for name, when in imports_of(path)
        if (top := name.partition(".")[0]) not in sys.stdlib_module_names | OURS
    }


def test_packages_that_load_with_a_module_are_core_dependencies() -> None:
    needed = {name: path for path in MODULES for name, when in pip_packages(path) if when == "loaded"}
    assert {name: path for name, path in needed.items() if name not in CORE} == {}


def test_imported_packages_belong_to_the_core_or_to_an_extra() -> None:
    used = {name for path in MODULES for name, _ in pip_packages(path)}
    known = CORE.union(*(EXTRAS[name] for name in EXTRAS if name not in ("test", "fuzz", "all", "docs")))
    assert used - known == set()


def test_the_core_installs_no_packages_of_runs_reports_and_viewers() -> None:
    parts = [path for path in MODULES if part_of(path) not in ("bench", "report", "viewers")]
    used = {name for path in parts for name, _ in pip_packages(path)}
    # The wheel of PoCL has no module. typer depends on pydantic, so it is always installed.
    assert CORE - used == {"pocl-binary-distribution", "pydantic"}


@of_the_whole
def test_errors_about_missing_modules_name_the_extra_that_installs_them() -> None:
    named_extras = set()
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("need_extra", "install"):
                words = [str(a.value) for a in node.args if isinstance(a, ast.Constant)]
                for extra in words[:1]:  # empty if the arguments of a call are not constants
                    named_extras.add(extra)
                    installed = EXTRAS[extra] | OURS
                    assert {DISTRIBUTIONS.get(word, word) for word in words[1:]} <= installed, path
    # Extras that are only useful in a checkout are not named in errors.
    assert named_extras == set(EXTRAS) - {"all", "test", "fuzz", "train", "docs"}


def test_extra_all_has_every_extra_except_for_developers_and_the_largest() -> None:
    (line,) = PROJECT["optional-dependencies"]["all"]
    included = line.partition("[")[2].rstrip("]").split(",")
    assert set(included) == set(EXTRAS) - {"all", "blender", "intel", "train", "docs", "fuzz", "test"}


def test_only_cross_checks_and_trials_import_peers() -> None:
    users = {
        path.relative_to(ROOT / "msb").as_posix()
        for path in MODULES
        if any(name.partition(".")[0] in PEERS for name, _ in imports_of(path))
    }
    assert users
    assert all(user.startswith(("topology/crosscheck", "trial")) for user in users)


def test_only_one_module_of_render_opens_files() -> None:
    drawing = [path for path in MODULES if part_of(path) == "render"]
    users = [path.name for path in drawing if any(name == "msb.api.opening" for name, _ in imports_of(path))]
    assert users == ["renderer.py"]


FOLDERS = ("msb", "viewers", "data_stubs", "benchmarks", "fuzz", "tools")
PACKAGES = {path.stem for path in (ROOT / "msb").iterdir()} - {"__init__"}


def top_package(names: Sequence[str]) -> str | None:
    """Return the top-level unit of a module: a package or module of msb/, the viewers, or a folder."""
    if "cli" not in names and {"command", "commands", "command_files"} & set(names):
        return "commands"  # commands may import all packages
    if names[0] == "msb":
        return names[1] if len(names) > 1 and names[1] in PACKAGES else None  # msb/__init__.py is no unit
    return "viewers" if names[0] == "msb_viewers" else names[0] if names[0] in FOLDERS else None


def unit_imports() -> set[tuple[str, str, When]]:
    """Return (importing unit, imported unit, when) of all imports between units."""
    return {
        (importer, imported, when)
        for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
        for name, when in imports_of(path)
        if (importer := top_package(path.relative_to(ROOT).with_suffix("").parts))
        and (imported := top_package(name.split(".")))
        and importer != imported
    }


def test_imports_have_no_cycles() -> None:
    """Units have an order in which each unit imports only earlier units."""
    below: dict[str, set[str]] = {}
    for importer, imported, when in unit_imports():
        if when != "never":
            below.setdefault(importer, set()).add(imported)
    assert [*TopologicalSorter(below).static_order()][-1] in (
        *FOLDERS,
        "commands",
    )  # raises CycleError for a cycle


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
def test_packages_are_not_loaded_before_they_are_needed(code: str, spared: set[str]) -> None:
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
    pairs = {(importer, imported) for importer, imported, _ in unit_imports()}
    print(f"{len({unit for pair in pairs for unit in pair})} units, {len(pairs)} imports between them")
