"""Who may import whom (DESIGN: Layout). The table below is the rule; the code is held to it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
GROUND = {"errors", "methods", "atomic", "nesting", "asset", "scenes", "_version"}
"""NumPy and the standard library only."""
ALLOWED: dict[str, set[str]] = {
    "__main__": {"cli"},
    "__init__": GROUND | {"topology", "render", "adapters", "metrics"},
    "errors": set(),
    "methods": set(),
    "atomic": {"errors"},
    "nesting": set(),
    "_version": set(),
    "asset": GROUND,
    "scenes": GROUND,
    "meshes": GROUND,
    "adapters": GROUND | {"meshes"},
    "cl": {"errors"},
    "topology": {"errors", "cl"},
    "metrics": {"errors", "nesting"},
    "render": GROUND | {"cl"},
    "reference": GROUND,
    "engines": GROUND | {"render", "meshes"},
    "report": {"errors", "methods", "bench", "_version"},  # of bench, the records and what follows from them
    "bench": GROUND | {"meshes", "adapters", "topology", "metrics", "render", "reference", "engines", "cl"},
}
ANYTHING = {"cli", "viewers"}
LAZY = {
    "torch",
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
}
"""Imported inside the function that needs them, never when a module loads."""
FOREIGN: dict[str, set[str]] = {
    "topology": {"numpy", "scipy", "igl", "pymeshlab", "manifold3d", "networkx", "trimesh"},
    "meshes": {"numpy", "trimesh"},
    "cl": {"numpy", "pyopencl"},
    "adapters": {"numpy", "yaml", "PIL"},
    "render": {"numpy", "PIL", "OpenEXR", "av"},
    "metrics": {"numpy", "scipy", "skimage", "trimesh", "PIL", "OpenEXR", "torch"},
    "cli": {"numpy", "typer", "rich", "msb_viewers"},
    "viewers": {"numpy", "PIL", "pyvista", "vtkmodules", "matplotlib"},
    "bench": {"numpy", "pydantic", "PIL", "filelock", "psutil", "pynvml", "distributed"},
    "engines": {"numpy", "wgpu", "bpy", "mathutils", "gpu", "OpenEXR", "PIL"},
    "report": {"pydantic", "PIL", "jinja2", "matplotlib"},
}
"""Third-party packages a part may use; the ground and everything not named here: numpy."""
PEERS = {"igl", "pymeshlab", "manifold3d", "networkx"}
MODULES = sorted([*(ROOT / "msb").rglob("*.py"), *(ROOT / "viewers").rglob("*.py")])


def part_of(path: Path) -> str:
    if path.is_relative_to(ROOT / "viewers"):
        return "viewers"
    inside = path.relative_to(ROOT / "msb")
    return inside.parts[0].removesuffix(".py")


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
            found.append((node.module or "", at_load))
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_what_its_part_may(path: Path) -> None:
    part = part_of(path)
    for name, at_load in imports_of(path):
        top, _, rest = name.partition(".")
        if top == "msb" and part not in ANYTHING:
            target = rest.partition(".")[0]
            if target and target != part:
                assert target in ALLOWED[part], f"{path}: {part} may not import msb.{target}"
        elif top == "msb_viewers" and part == "viewers":
            continue
        elif top != "msb" and top not in sys.stdlib_module_names:
            wanted = FOREIGN.get(part, {"numpy"})
            assert top in wanted, f"{path}: {part} may not import {top}"
            assert not (at_load and top in LAZY), f"{path}: import {top} inside the function that needs it"


def test_only_crosscheck_knows_the_peers() -> None:
    users = {
        path.relative_to(ROOT / "msb").as_posix()
        for path in MODULES
        if any(name.partition(".")[0] in PEERS for name, _ in imports_of(path))
    }
    assert users
    assert all(user.startswith("topology/crosscheck") for user in users)


def test_rules_cover_every_part() -> None:
    assert {part_of(path) for path in MODULES} <= set(ALLOWED) | ANYTHING


def test_importing_msb_loads_nothing_heavy() -> None:
    code = "import msb, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert not {"numpy", "scipy", "typer", "rich", "pyopencl"} & set(loaded.split())


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nsys.argv = ['msb', 'audit', '--help']\nfrom msb.cli import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert stop.code == 0\nprint(*sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    modules = loaded.splitlines()[-1].split()
    assert "typer" in modules
    assert not {"numpy", "scipy", "rich", "pyopencl", "trimesh"} & set(modules)


def test_auditing_an_asset_needs_only_numpy_and_scipy() -> None:
    code = (
        "import msb, sys; msb.audit(msb.load('data_stubs/splat_like.triasset'));"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout
    assert not {"torch", "trimesh", "igl", "pymeshlab", "networkx", "pyopencl", "skimage"} & set(
        loaded.split()
    )
