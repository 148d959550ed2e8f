"""Reading records: invalid folders, results that must not be mixed, and files that a record may name."""

import os
from pathlib import Path
from typing import Any

import pytest

from msb.bench.records import File
from msb.errors import InputError, UsageError
from msb.report.results import Place, read_results
from tests.report.factory import METRICS, make_result, measure

DESK = Place("capture", "desk", "two_dts")


def write_two(root: Path, **changes: Any) -> Path:
    """Write two conditions of an asset, the second one with `changes`."""
    measure(root, "non_engine")
    measure(root, "dedicated", **changes)
    return root


def test_records_are_read_by_asset_and_condition(tmp_path: Path) -> None:
    results = read_results(write_two(tmp_path))
    assert list(results.places) == [DESK]
    assert list(results.places[DESK]) == ["non_engine", "dedicated"]
    assert (len(results), results.notes, results.roots) == (2, (), [tmp_path])


def test_folders_without_results_are_rejected(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere", ""):
        with pytest.raises(InputError, match="FILE_NOT_FOUND"):
            read_results(path)
    with pytest.raises(InputError, match="RESULTS_EMPTY"):
        read_results(tmp_path)


OTHER_ASSET = {"asset": File(path="x", bytes=1, sha256="0" * 64)}
OTHER_SETUP = {"setup": {"background": (1.0, 1.0, 1.0)}}
OTHER_METRIC = {"quality": {"metrics": ({**METRICS[0], "data_range": 255.0}, METRICS[1])}}
OTHER_SETTINGS = {"renderer": {"name": "msb-dedicated", "settings": {"supersample": 4}}}
OTHER_VERSION = {"renderer": {"version": "0"}}


def other_images() -> dict[str, Any]:
    quality = make_result(*DESK, "dedicated").quality
    return {"quality": {"images": quality.images[1:2]}}


@pytest.mark.parametrize("changes", [OTHER_ASSET, OTHER_SETUP, OTHER_METRIC, other_images()])
def test_results_that_must_not_be_compared_are_rejected(tmp_path: Path, changes: Any) -> None:
    write_two(tmp_path, **changes)
    with pytest.raises(UsageError, match="RESULTS_MIXED"):
        read_results(tmp_path)
    assert len(read_results(tmp_path, allow_mixed=True).notes) == 1


def test_versions_of_libraries_and_setups_of_methods_may_differ(tmp_path: Path) -> None:
    write_two(tmp_path, quality={"metrics": ({**METRICS[0], "libraries": {"numpy": "1"}}, METRICS[1])})
    measure(tmp_path, "dedicated", method="diffsoup", **OTHER_SETUP)
    assert read_results(tmp_path).notes == ()


def test_the_later_folder_counts_for_equal_cells(tmp_path: Path) -> None:
    for name, seconds in (("old", 1.0), ("new", 2.0)):
        measure(tmp_path / name, "dedicated", seconds=seconds)
    results = read_results(tmp_path / "old", tmp_path / "new")
    assert results.places[DESK]["dedicated"].result.seconds == 2.0
    assert len(results) == 1
    measure(tmp_path / "new", "dedicated", **OTHER_ASSET)
    with pytest.raises(UsageError, match="RESULTS_MIXED"):
        read_results(tmp_path / "old", tmp_path / "new")


@pytest.mark.parametrize("changes", [OTHER_ASSET, OTHER_SETTINGS, OTHER_VERSION])
def test_different_measurements_of_a_cell_are_never_merged(tmp_path: Path, changes: Any) -> None:
    folders = tmp_path / "a" / "results", tmp_path / "b" / "results"
    for folder in folders:
        write_two(folder)
    measure(folders[1], "dedicated", **changes)
    with pytest.raises(UsageError, match="RESULTS_MIXED"):
        read_results(*folders)
    results = read_results(*folders, allow_mixed=True)
    assert [place.method for place in results.places] == ["two_dts, a/results", "two_dts, b/results"]
    assert results.notes


def test_a_labelled_model_is_separate_from_another_model_of_its_method(tmp_path: Path) -> None:
    measure(tmp_path, "dedicated")
    measure(tmp_path, "dedicated", cell={"label": "ours"}, **OTHER_ASSET)
    assert [place.method for place in read_results(tmp_path).places] == ["ours", "two_dts"]


def test_files_outside_the_results_folder_are_not_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"secret")
    root = tmp_path / "results"
    loaded = read_results(write_two(root)).places[DESK]["dedicated"]
    inside = loaded.path.parent / "images" / "x.png"
    inside.parent.mkdir()
    inside.write_bytes(b"x")
    assert loaded.file("images/x.png") == inside.resolve()
    (inside.parent / "link.png").symlink_to(secret)
    outside = os.path.relpath(secret, loaded.path.parent)
    inside_names = ("images/link.png", "images/absent.png", "images", "a\0b", "x" * 5000)
    for name in (outside, str(secret), *inside_names):
        assert loaded.file(name) is None
