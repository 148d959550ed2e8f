"""Each capability can be deleted.

All other modules then load, the remaining commands are listed, and tests pass. Each test works on a copy of
the tree. If a single capability is deleted, every module is imported and the tests of the commands' help run.
If all capabilities are deleted, all remaining tests are collected, and the tests of `QUICK` run. ``python -m
tests.test_deletable bake`` runs all quick tests that remain without the capability `bake`.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import pytest

from msb.cli.commands import BUILT_IN
from tests.conftest import CAPABILITIES, ROOT, of_the_whole

IMPORT_ALL = """
import importlib, pkgutil, msb
packages = [msb]
try:
    import msb_viewers
    packages.append(msb_viewers)
except ModuleNotFoundError:
    pass
walks = [pkgutil.walk_packages(package.__path__, package.__name__ + ".") for package in packages]
names = [module.name for modules in walks for module in modules]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print(len(names), *(package.__path__[0] for package in packages))
"""
# An editable installation adds the viewers of another checkout to the search path. Remove them.
SITE = """
import os, sys
others = [place for place in sys.path if place not in {places!r} and os.path.isdir(place + "/msb_viewers")]
sys.path[:] = [place for place in sys.path if place not in others]
"""

QUICK = "api or cli or delivery or snapshots or docs"
"""Value of pytest's -k.

`QUICK` selects tests of the Python interface, the command kit, help texts and documentation.
"""


def copy_without(capabilities: Iterable[str], copy: Path) -> None:
    """Copy the files of this checkout, except the folders of the capabilities."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, check=True, text=True,
    )  # fmt: skip
    removed = tuple(f"{folder}/" for name in capabilities for folder in CAPABILITIES[name])
    for name in filter(None, listed.stdout.split("\0")):
        if not name.startswith(removed) and (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)


def run(copy: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the copy, without access to packages of another checkout."""
    places = [str(copy), str(copy / "viewers")]
    site = copy.parent / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(SITE.format(places=places))
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *places]), "COLUMNS": "80"}
    return subprocess.run(
        [sys.executable, *words], cwd=copy, env=env, capture_output=True, text=True, check=False
    )


def commands_of(capability: str) -> set[str]:
    """Return the commands of a capability. The modules of these commands are deleted with the capability."""
    folders = [folder.replace("/", ".") for folder in CAPABILITIES[capability] if folder.startswith("msb/")]
    modules = tuple(f"{folder}." for folder in folders or ["msb_viewers"])
    entries = {name: place.module for places in BUILT_IN.values() for name, place in places.items()}
    return {name for name, module in entries.items() if module.startswith(modules)}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("this is not a git checkout")
    return tmp_path / "copy"


def run_tests(copy: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run quick tests of the copy, selected by pytest's options."""
    return run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *words)


def check(capabilities: Iterable[str], copy: Path) -> None:
    """Check that all modules load, and that the remaining commands are listed."""
    copy_without(capabilities, copy)
    removed = {name for capability in capabilities for name in commands_of(capability)}
    loaded = run(copy, "-c", IMPORT_ALL)
    assert loaded.returncode == 0, loaded.stderr
    assert all(place.startswith(str(copy)) for place in loaded.stdout.split()[1:])
    top_help = run(copy, "-m", "msb", "--help")
    assert (top_help.returncode, top_help.stderr) == (0, "")
    listed = {line.split()[0] for line in top_help.stdout.splitlines() if line.startswith("  ")}
    entries = {name for places in BUILT_IN.values() for name in places}
    assert listed & entries == entries - removed
    for name in removed:
        missing = run(copy, "-m", "msb", name, "--help")
        assert (missing.returncode, missing.stderr.split(":")[0]) == (2, "EXTRA_MISSING"), name


@pytest.mark.slow
@of_the_whole
@pytest.mark.parametrize("capability", CAPABILITIES)
def test_the_rest_works_without(capability: str, copy: Path) -> None:
    check([capability], copy)
    tested = run_tests(copy, "tests/snapshots", "tests/test_methods.py", "tests/test_errors.py")
    assert tested.returncode == 0, tested.stdout[-3000:]


@pytest.mark.slow
@of_the_whole
def test_the_core_works_alone(copy: Path) -> None:
    check(CAPABILITIES, copy)
    tested = run_tests(copy, "-k", QUICK)
    assert tested.returncode == 0, tested.stdout[-3000:]


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_a_capability_has_commands(capability: str) -> None:
    assert commands_of(capability)


def main() -> None:
    """Check one capability, and run all remaining quick tests."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        check([sys.argv[1]], copy)
        tests = run_tests(copy, *sys.argv[2:])
        print(tests.stdout)
        sys.exit(tests.returncode)


if __name__ == "__main__":
    main()
