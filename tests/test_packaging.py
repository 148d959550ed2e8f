"""Wheel and sdist contain all files of the packages. tests/test_guides.py runs the wheel."""

import tarfile
import zipfile
from pathlib import Path

import pytest

from msb.api.demo import CONTENTS
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

pytest.importorskip("hatchling.builders", reason="extra test is not installed (hatchling)")
PACKAGES = {"msb": ROOT / "msb", "msb_viewers": ROOT / "viewers" / "msb_viewers"}


def package_files() -> set[str]:
    """Return the paths, within a wheel, of all files of the packages and of the demo data."""
    stubs = ROOT / "data_stubs"
    roots = [(name, folder, folder) for name, folder in PACKAGES.items()]
    roots += [("msb/demo_data", stubs, stubs / name) for name in CONTENTS]
    return {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder, root in roots
        for path in (root, *root.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the wheel and the sdist of this tree."""
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    folder = tmp_path_factory.mktemp("dist")
    for builder in (WheelBuilder, SdistBuilder):
        list(builder(str(ROOT)).build(directory=str(folder), versions=["standard"]))
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (path,) = built.glob("*.whl")
    return path


def inside(wheel: Path) -> set[str]:
    """Return the paths of the files in `wheel`, without its metadata."""
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def test_wheel_holds_every_file_of_the_packages_and_nothing_else(wheel: Path) -> None:
    expected = package_files()
    assert inside(wheel) == expected
    kinds = {".py", ".cl", ".wgsl", ".json", ".html", ".js", ".css", ".typed"}
    assert {Path(name).suffix for name in expected} >= kinds


def test_sdist_can_be_built_tested_and_read(built: Path, wheel: Path, tmp_path: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        archive.extractall(tmp_path, filter="data")
    (tree,) = tmp_path.iterdir()
    for name in (
        "README.md",
        "CHANGELOG.md",
        "LICENSE",
        "Makefile",
        "pyproject.toml",
        "docs/guides/trained.md",
        "integrations/js/package.json",
        "mkdocs.yml",
        "tests/golden/views.py",
        "data_stubs/protocol.toml",
        "benchmarks/recipes/common.sh",
        ".ci/run",
    ):
        assert (tree / name).is_file(), name
    from hatchling.builders.wheel import WheelBuilder

    (again,) = WheelBuilder(str(tree)).build(directory=str(tmp_path / "again"), versions=["standard"])
    assert inside(Path(again)) == inside(wheel)
