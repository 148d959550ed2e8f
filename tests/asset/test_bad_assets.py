"""Each bad asset gives an error with its code and a clear message in one line."""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import msb
from msb.asset import load, validate
from msb.errors import AssetError, InputError, MsbError
from tests.corpus.bad_assets import CASES, write_case
from tests.corpus.case import Case
from tests.corpus.good import decoder, mesh, parts, soup
from tests.corpus.refusals import find_message, read_messages

TRIASSET_CODES = AssetError.codes
ROW = ["code", "severity", "message", "pointer", "file", "value", "limit"]
NOBODY = 65534


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that all users can access, unlike `tmp_path`."""
    root = Path(tempfile.mkdtemp(prefix="msb-bad-"))
    root.chmod(0o755)
    yield root
    for path in root.rglob("*"):
        if not path.is_symlink():
            path.chmod(0o700)
    shutil.rmtree(root)


@contextlib.contextmanager
def checked_permissions() -> Iterator[None]:
    """Run the block without the privileges of root."""
    if os.geteuid() != 0:
        yield
        return
    try:
        os.seteuid(NOBODY)
    except OSError as error:
        pytest.skip(f"root can read all files, and cannot drop its privileges: {error}")
    try:
        yield
    finally:
        os.seteuid(0)


def permissions(case: Case) -> contextlib.AbstractContextManager[None]:
    return checked_permissions() if case.denied else contextlib.nullcontext()


def assert_clear(error: MsbError, path: Path) -> None:
    text = str(error)
    assert text.isprintable()
    assert text.startswith(f"{error.code}: {path}: ")
    assert len(text) < len(str(path)) + 400
    assert error.__cause__ is None or isinstance(error.__cause__, OSError | ValueError)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_load_and_validate_give_a_bad_asset_its_code(case: Case, folder: Path) -> None:
    path = write_case(case, folder)
    if case.denied:
        parts(mesh()).write_packed(folder / "good")
        load(folder / "good")  # this imports the codecs before files become unreadable
    with permissions(case):
        if case.found_by == "load" and case.severity == "error":
            with pytest.raises((AssetError, InputError)) as caught:
                load(path)
            assert caught.value.code == case.code
            assert_clear(caught.value, path)
        else:
            codes = [(item.code, item.severity) for item in load(path).warnings]
            assert codes == ([(case.code, case.severity)] if case.found_by == "load" else [])
    # `validate` reports the same code and no other error.
    if case.code in InputError.codes:
        with permissions(case), pytest.raises(InputError) as caught:
            validate(path)
        assert caught.value.code == case.code
        return
    with permissions(case):
        report = validate(path)
        findings = list(report.findings)
        if case.found_by == "command":
            assert not findings
            findings = msb.validate(path).findings
    errors = {item.code for item in findings if item.severity == "error"}
    assert (case.code, case.severity) in {(item.code, item.severity) for item in findings}
    assert case.denied or find_message(findings, case.code) == read_messages()[f"asset/{case.name}"]
    assert errors == {*case.also, *([case.code] if case.severity == "error" else [])}
    assert report.valid == (not errors)
    assert (report.asset is None) == (case.found_by == "load" and case.severity == "error")
    assert all(item.message.isprintable() and len(item.message) < 400 for item in findings)
    assert all((item.pointer or "").isprintable() for item in findings)
    rows = [item.to_dict() for item in findings]
    assert all(list(row) == ROW for row in rows)
    assert len(json.dumps(rows, allow_nan=False)) < 2500 * max(1, len(rows))


@pytest.mark.parametrize("make", [mesh, soup, decoder])
def test_the_templates_of_bad_assets_are_valid(make, tmp_path: Path) -> None:
    parts(make()).write_packed(tmp_path / "packed")
    parts(make()).write_folder(tmp_path / "folder")
    for path in (tmp_path / "packed", tmp_path / "folder"):
        assert load(path).warnings == ()
        assert validate(path).findings == ()


def test_every_code_of_the_format_has_a_case() -> None:
    assert {case.code for case in CASES if case.code.startswith("TRIASSET_")} == TRIASSET_CODES


def test_a_link_created_after_the_check_is_not_followed(tmp_path: Path, monkeypatch) -> None:
    """Another process replaces `buffers` by a link after the check, before a file in it is opened."""
    path, outside = tmp_path / "a.triasset", tmp_path / "outside"
    parts(mesh()).write_folder(path)
    parts(mesh()).write_folder(outside)
    real_lstat = Path.lstat

    def swap_after_look(self: Path):
        status = real_lstat(self)
        if self.name == "positions.bin" and not (path / "buffers").is_symlink():
            (path / "buffers").rename(tmp_path / "aside")
            (path / "buffers").symlink_to(outside / "buffers")
        return status

    monkeypatch.setattr(Path, "lstat", swap_after_look)
    with pytest.raises(AssetError) as caught:
        load(path)
    assert caught.value.code in ("TRIASSET_DAMAGED", "TRIASSET_FILE_UNREADABLE")
