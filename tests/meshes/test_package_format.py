"""The mesh format of docs/extending.md in a separate package: installed, failing, and invalid."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.base.packages import PackageWarning
from msb.errors import InputError, MeshFileError, UsageError
from msb.meshes import MESH_SUFFIXES, Mesh, formats, read_mesh, write_mesh
from msb.meshes.files import write_whole
from msb.meshes.formats import FORMATS, list_written_suffixes
from tests.meshes.checks import check_bad, check_format
from tests.test_docs_commands import install_example

TRIANGLE = b"tri\n0 0 0 1 0 0 1 1 0\n"
ENTRY = "tri = msb_tri:FORMAT"
Edit = Callable[..., None]


def forget() -> None:
    formats._theirs.cache_clear()
    sys.modules.pop("msb_tri", None)


@pytest.fixture
def edit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Edit]:
    """Install the format with a replaced part of its text or of its entry point."""
    site = install_example("docs/extending.md", tmp_path / "site")
    monkeypatch.syspath_prepend(site)

    def change(old: str = "", new: str = "", entry: str = ENTRY) -> None:
        file = site / "msb_tri.py"
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new) if old else text)
        (site / "msb_tri-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.meshes]\n{entry}\n")
        forget()

    yield change
    monkeypatch.undo()
    forget()


def test_an_installed_format_is_read_and_written_like_ours(edit: Edit, tmp_path: Path) -> None:
    assert ".tri" not in MESH_SUFFIXES or "msb_tri" in sys.modules
    edit()
    assert ".tri" in MESH_SUFFIXES
    assert ".tri" in list_written_suffixes()
    check_format(FORMATS[".tri"], TRIANGLE, [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]], tmp_path)
    check_bad(FORMATS[".tri"], b"tri\n0 0 0\n", "MESH_FILE_INVALID", tmp_path)
    (tmp_path / "a.tri").write_bytes(TRIANGLE)
    assert msb.audit(tmp_path / "a.tri").counts.faces == 1
    msb.convert(tmp_path / "a.tri", tmp_path / "b.ply")
    msb.save(msb.open(tmp_path / "b.ply"), tmp_path / "c.tri")
    assert np.array_equal(read_mesh(tmp_path / "c.tri").vertices, read_mesh(tmp_path / "a.tri").vertices)


@pytest.mark.parametrize(
    "text",
    ["raise ValueError('no')", "raise SystemExit(3)", "return None", "return Mesh([], [])", "assert 0"],
)
def test_a_failing_reader_means_an_invalid_file(edit: Edit, tmp_path: Path, text: str) -> None:
    edit("    text = source", f"    {text}\n    text = source")
    (tmp_path / "a.tri").write_bytes(TRIANGLE)
    with pytest.raises(MeshFileError, match=r"MESH_FILE_INVALID: .*msb_tri") as caught:
        msb.open(tmp_path / "a.tri")
    assert caught.value.file == str(tmp_path / "a.tri")


def test_a_failing_writer_names_its_package_and_leaves_no_file(edit: Edit, tmp_path: Path) -> None:
    edit("    stream.write", "    print('hello')\n    1 / 0\n    stream.write")
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(UsageError, match=r"PACKAGE_LEFT_OUT: .*msb_tri.*ZeroDivisionError"):
        write_whole(mesh, tmp_path / "a.tri")
    assert not list(tmp_path.glob("a*"))


def test_a_full_disk_is_not_blamed_on_the_package(edit: Edit, tmp_path: Path) -> None:
    edit("    stream.write", "    raise OSError(28, 'no space left')\n    stream.write")
    with pytest.raises(OSError, match="no space"), (tmp_path / "a").open("wb") as stream:
        write_mesh(Mesh(np.eye(3), np.array([[0, 1, 2]])), stream, suffix=".tri")


INVALID = {
    '(".tri",)': ['".tri"', "()", '(".TRI",)', '("tri",)', '(".ply",)', '(".triasset",)', "(3,)"],
    '"TRI", (': ["3, (", '"a\\nb", (', '"", ('],
    "read, write": ["None, write", "read, 3"],
    "begins=BEGINS": ["begins=re.compile(b'')", "begins=re.compile('tri')", "begins=b'tri'"],
    "is_soup=True": ["up='y'", "keeps=('tangents',)", "keeps='textures'"],
    "FORMAT =": ["FORMAT = 3 #", "1 / 0 #"],
}


@pytest.mark.parametrize(("old", "new"), [(old, new) for old, news in INVALID.items() for new in news])
def test_an_invalid_format_is_ignored_with_one_warning(
    edit: Edit, tmp_path: Path, old: str, new: str
) -> None:
    edit(old, new)
    (tmp_path / "a.tri").write_bytes(TRIANGLE)
    with pytest.warns(PackageWarning, match=r"PACKAGE_LEFT_OUT: .*msb_tri") as caught:
        assert ".ply" in MESH_SUFFIXES
    assert len(caught) == 1
    assert FORMATS[".ply"].title == "PLY"
    with pytest.raises(InputError, match="FILE_NOT_RECOGNISED"):
        read_mesh(tmp_path / "a.tri")


def test_a_name_of_ours_and_a_suffix_of_another_package_are_ignored(edit: Edit) -> None:
    edit(entry=f"{ENTRY}\nply = msb_tri:FORMAT\nzzz = msb_tri:FORMAT")
    with pytest.warns(PackageWarning, match="PACKAGE_LEFT_OUT") as caught:
        assert FORMATS[".tri"].title == "TRI"
    assert len(caught) == 2
