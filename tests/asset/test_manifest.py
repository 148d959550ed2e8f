"""The manifest: versions, unknown keys, and equal findings for both forms of an asset."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.asset import Manifest, load, validate, write_asset
from msb.asset.check import check_manifest
from tests.corpus.bad_assets import write_case
from tests.corpus.bad_folders import VALUE_CASES
from tests.corpus.bad_manifests import BUFFER_CASES, FIELD_CASES
from tests.corpus.case import Case
from tests.corpus.good import Parts, decoder, mesh, parts, soup

ROOT = Path(msb.__file__).parents[1]
SHIPPED = sorted(ROOT.glob("data_stubs/**/*.triasset"))


def reloaded(changed: Parts, tmp_path: Path) -> msb.Asset:
    changed.write_packed(tmp_path / "changed.triasset")
    return load(tmp_path / "changed.triasset")


@pytest.mark.parametrize("make", [mesh, soup, decoder])
def test_a_manifest_survives_its_own_bytes(make) -> None:
    manifest = make().manifest
    data = manifest.to_bytes()
    again = Manifest.from_dict(json.loads(data))
    assert again == manifest
    assert again.to_bytes() == data
    assert check_manifest(json.loads(data)) == []
    assert data.endswith(b"}\n")
    assert b"\r" not in data


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_assets_are_valid(path: Path) -> None:
    assert validate(path).findings == ()


def test_a_newer_minor_version_is_read_with_a_warning(tmp_path: Path) -> None:
    lod = {"levels": [1, 2.5, None, True, "\u00e9\U0001f600"], "deep": {"a": {"b": []}}}
    newer = parts(mesh()).change("/version", "1.7").change("/lod", lod).change("/extra", "a key of that name")
    asset = reloaded(newer, tmp_path)
    codes = {(item.code, item.severity, item.pointer) for item in asset.warnings}
    assert codes == {
        ("TRIASSET_VERSION_NEWER", "warning", "/version"),
        ("TRIASSET_FIELD_UNKNOWN", "warning", "/lod"),
        ("TRIASSET_FIELD_UNKNOWN", "warning", "/extra"),
    }
    assert asset.manifest.extra == {"lod": lod, "extra": "a key of that name"}
    for form in ("packed", "folder"):
        write_asset(asset, tmp_path / form, form)
        again = load(tmp_path / form)
        assert again.manifest == asset.manifest
        assert again.manifest.to_bytes() == asset.manifest.to_bytes()
        assert validate(tmp_path / form).valid


def test_whole_numbers_may_stand_for_floats(tmp_path: Path) -> None:
    asset = reloaded(parts(mesh()).change("/bounds", {"min": [0, 0, 0], "max": [1, 2, 3]}), tmp_path)
    assert asset.manifest == mesh().manifest


def test_an_unsupported_version_is_the_only_finding(tmp_path: Path) -> None:
    """Other keys are not checked, because their meaning in version 2 is unknown."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a/manifest.json").write_text('{"format": "triasset", "version": "2.0", "buffers": 3}')
    assert [item.code for item in validate(tmp_path / "a").findings] == ["TRIASSET_VERSION_UNSUPPORTED"]


def test_a_pointer_escapes_what_a_name_may_hold() -> None:
    manifest = parts(mesh()).manifest
    manifest["settings"]["a/b~c"] = {"value": 1, "source": "flag"}
    manifest["x/~y"] = 0
    assert {item.pointer for item in check_manifest(manifest)} == {"/settings/a~1b~0c", "/x~1~0y"}


BOTH_FORMS = [case for case in (*FIELD_CASES, *BUFFER_CASES, *VALUE_CASES) if case.found_by != "command"]


@pytest.mark.slow
@pytest.mark.parametrize("case", BOTH_FORMS, ids=lambda case: case.name)
def test_both_forms_of_a_bad_asset_have_the_same_findings(case: Case, tmp_path: Path) -> None:
    path = write_case(case, tmp_path)
    other = tmp_path / "other"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(other)
    first, second = ({(f.code, f.severity, f.pointer) for f in validate(p).findings} for p in (path, other))
    assert first == second


def test_an_asset_has_a_text_for_people_and_notebooks(tmp_path: Path) -> None:
    asset = reloaded(parts(mesh()), tmp_path)
    assert "4 faces" in repr(asset)
    assert "ok" not in repr(asset)
    assert asset.audit().verdict == "ok"
    assert repr(asset).endswith(f", ok, {tmp_path / 'changed.triasset'}>")
    assert repr(replace(asset, opened_from=Path("a\nb"))).endswith(", a\\nb>")
    assert "&lt;i&gt;" in replace(asset, opened_from=Path("<i>"))._repr_html_()


def test_an_asset_has_the_functions_of_the_package(tmp_path: Path) -> None:
    asset = msb.open(ROOT / "data_stubs/checkpoint")
    assert asset.audit(weld="exact").welded is not None
    fixed = asset.repair(["orient"], weld="exact")
    assert fixed.plan == ("orient",)
    assert fixed.asset.opened_from == asset.opened_from == ROOT / "data_stubs/checkpoint"
    camera = msb.read_cameras(ROOT / "data_stubs/views.json")[0].resized(16, 12)
    frame = asset.render(camera, "standard", background="white")
    assert np.array_equal(frame.image, msb.render(asset, camera, background="white").image)
    asset.save(tmp_path / "a.triasset", form="folder")
    assert msb.load(tmp_path / "a.triasset").manifest == asset.manifest
