"""Official renderings: matched by name or number, hashed, and rejected if they are invalid."""

import hashlib
import shutil
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from msb.base.files import file_sha256
from msb.bench.protocol import ProtocolFile
from msb.bench.renders import find_renders
from msb.bench.run import run_protocol
from msb.scenes.datasets import read_scene
from tests.bench.protocols import STUBS, change_tables, get_plan, read_cell

pytestmark = pytest.mark.slow


def upstream(file: ProtocolFile, folder: Path) -> ProtocolFile:
    """Return a protocol of two_dts alone, with official renderings in `folder` and no model."""
    return change_tables(file, method={"non_engine": str(folder), "model": None}, alone=True)


@pytest.fixture
def official(again: ProtocolFile, tmp_path: Path) -> Path:
    """Official renderings: images of our reference renderer, named like the photographs."""
    folder = tmp_path / "official"
    shutil.copytree(again.results / "cells/nerf_synthetic/pebble/two_dts/non_engine/images", folder)
    return folder


def test_official_renderings_are_imported_by_name(again: ProtocolFile, official: Path) -> None:
    quality = read_cell(again, "two_dts/non_engine").quality
    report = run_protocol(upstream(again, official))
    assert list(get_plan(report)) == ["two_dts/non_engine"]
    record = read_cell(again, "two_dts/non_engine")
    assert record.quality == quality
    assert (record.renderer.kind, record.renderer.settings) == ("upstream", {"matched_by": "name"})
    assert record.renders.path == str(official)
    lines = sorted(
        (path.relative_to(official).as_posix(), hashlib.sha256(path.read_bytes()).hexdigest())
        for path in official.rglob("*.png")
    )
    text = "".join(f"{sha256}  {name}\n" for name, sha256 in lines)
    assert record.renders.sha256 == hashlib.sha256(text.encode()).hexdigest()
    sums = "\n".join(f"{sha256} *./{name}" for name, sha256 in lines)
    (official / "SHA256SUMS").write_text(sums)
    assert get_plan(run_protocol(upstream(again, official))) == {"two_dts/non_engine": "done"}
    (official / "SHA256SUMS").unlink()
    first, second, *_ = sorted(official.rglob("*.png"))
    first.write_bytes(second.read_bytes())
    outcome = get_plan(run_protocol(upstream(again, official)))
    assert outcome == {"two_dts/non_engine": {"quality": "renders changed"}}


def test_official_renderings_by_number(again: ProtocolFile, official: Path, tmp_path: Path) -> None:
    quality = read_cell(again, "two_dts/non_engine").quality
    numbered = tmp_path / "numbered"
    numbered.mkdir()
    for index, image in enumerate(quality.images):
        shutil.copy(official / Path(str(image.file)).relative_to("images"), numbered / f"{index:05d}.png")
    run_protocol(upstream(again, numbered))
    record = read_cell(again, "two_dts/non_engine")
    assert record.renderer.settings == {"matched_by": "number"}
    assert record.quality == quality


def shrink(first: Path) -> None:
    with Image.open(first) as image:
        image.resize((8, 8)).save(first)


WRONG: dict[str, tuple[str, Callable[[Path, Path], object]]] = {
    "missing": ("METRIC_IMAGE_NAMES", lambda _, first: first.unlink()),
    "extra": ("METRIC_IMAGE_NAMES", lambda folder, first: shutil.copy(first, folder / "extra.png")),
    "size": ("METRIC_SIZES_DIFFER", lambda _, first: shrink(first)),
    "hash": (
        "RENDERS_CHANGED",
        lambda folder, first: (folder / "SHA256SUMS").write_text(
            f"{'0' * 64}  {first.relative_to(folder).as_posix()}\n"
        ),
    ),
    "noise": ("FILE_UNREADABLE", lambda folder, _: (folder / "SHA256SUMS").write_bytes(b"\xff" * 99)),
    "gone": ("FILE_NOT_FOUND", lambda folder, _: shutil.rmtree(folder)),
}


@pytest.mark.parametrize(("code", "spoil"), WRONG.values(), ids=WRONG)
def test_invalid_official_renderings_are_rejected(
    again: ProtocolFile, official: Path, code: str, spoil: Callable[[Path, Path], object]
) -> None:
    spoil(official, sorted(official.rglob("*.png"))[0])
    assert run_protocol(upstream(again, official)).exit_status == 3
    record = read_cell(again, "two_dts/non_engine")
    assert (record.status, record.reason.code, record.quality) == ("failed", code, None)


def test_names_of_renderings_are_compared_in_unicode_normal_form(tmp_path: Path) -> None:
    composed, decomposed = (unicodedata.normalize(form, "caf\u00e9") for form in ("NFC", "NFD"))
    camera = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble").test[0]
    file = tmp_path / f"{decomposed}.png"
    Image.new("RGB", (camera.width, camera.height)).save(file)
    (tmp_path / "SHA256SUMS").write_text(f"{file_sha256(file)}  {composed}.png\n", "utf-8")
    (rendering,) = find_renders(tmp_path, [replace(camera, name=f"{composed}.png")]).files
    assert rendering.samefile(file)
