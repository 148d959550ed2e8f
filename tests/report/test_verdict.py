"""The verdict on an asset and its page: what it is good for, what was tried, and what bakes make of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb.bench.folder import Results
from msb.report.build import build_report
from msb.report.numbers import Key, condition_order, condition_title
from msb.report.pages import report_files
from msb.report.results import read_results
from msb.report.verdict import Likeness
from tests.report.factory import (
    SAME,
    TASK,
    VIEWS,
    make_result,
    measure,
    note_hashes,
    repairs,
    trial,
    verdict_of,
    way,
    write,
)
from tests.report.test_golden import bakes

PLAIN, SHADED = "A plain mesh in any engine (Standard)", "A model with its own shaders (Dedicated)"


@pytest.mark.parametrize(("loss", "mark"), [(-0.2, "YES"), (0.99, "YES"), (1.0, "WITH CARE"), (3.0, "NO")])
def test_looks_follow_the_loss_and_say_what_they_are_held_against(
    tmp_path: Path, loss: float, mark: str
) -> None:
    measure(tmp_path, "non_engine", 20.0, renderer={"kind": "msb_reference"})
    measure(tmp_path, "dedicated", 20.0 - loss)
    said = verdict_of(tmp_path)
    dedicated = said[SHADED]
    assert dedicated.mark == mark
    assert f"{abs(loss):.2f} dB" in dedicated.why
    assert said[PLAIN].mark == "UNKNOWN"


@pytest.mark.parametrize(
    ("noise", "psnr", "mark", "said"),
    [
        (0, (30.0, 30.0), "YES", ": 100.0 dB"),
        (2, (30.0, 30.0), "YES", ": 4"),
        (9, (30.0, 34.0), "WITH CARE", "gains 4.00 dB"),
        (60, (30.0, 30.0), "NO", ": 1"),
        (60, (6.71, 7.26), "UNKNOWN", "6.71 dB"),
        (0, (30.0, 20.0), "YES", "loses 10.00 dB"),
        (0, (30.0, 30.001), "YES", "loses nothing"),
    ],
)
def test_looks_are_those_of_the_two_renderings(
    tmp_path: Path, noise: int, psnr: tuple[float, float], mark: str, said: str
) -> None:
    random = np.random.default_rng(3)
    picture = random.integers(70, 180, (64, 96, 3))
    for condition, value, change in zip(("non_engine", "dedicated"), psnr, (0, noise), strict=True):
        made = measure(tmp_path, condition, value)
        file = Results(tmp_path).record(made.cell)
        for name in VIEWS:
            place = (file.parent / "images" / name).with_suffix(".png")
            place.parent.mkdir(parents=True, exist_ok=True)
            changed = picture + random.integers(-change, change + 1, picture.shape)
            Image.fromarray(changed.astype(np.uint8)).save(place)
        note_hashes(file)
    dedicated = verdict_of(tmp_path)[SHADED]
    assert (dedicated.mark, said in dedicated.why) == (mark, True), dedicated


@pytest.mark.parametrize("pictures", [True, False])
def test_without_the_own_renderer_standard_is_held_against_dedicated(tmp_path: Path, pictures: bool) -> None:
    for condition, psnr in (("dedicated", 30.0), ("standard", 28.5)):
        measure(tmp_path, condition, psnr, images=pictures)
    said = verdict_of(tmp_path)
    plain = said[PLAIN]
    assert plain.mark == "WITH CARE"
    assert ("between the two renderings" in plain.why) is pictures
    assert "loses 1.50 dB" in plain.why
    assert said[SHADED].mark == "UNKNOWN"


@pytest.mark.parametrize(
    ("p95", "kind", "mark", "printed"),
    [
        (16.66, "gpu", "YES", "16.66"),
        (16.69, "gpu", "WITH CARE", "16.69"),
        (33.24, "gpu", "WITH CARE", "33.2"),
        (33.34, "gpu", "NO", "33.34"),
        (16.0, "cpu", "YES", "16.0"),
        (40.0, "cpu", "UNKNOWN", "40.0"),
    ],
)
def test_real_time_follows_the_p95_and_no_time_is_printed_as_a_limit_that_it_misses(
    tmp_path: Path, p95: float, kind: str, mark: str, printed: str
) -> None:
    measure(tmp_path, "dedicated", timing={"p95_ms": p95, "device_kind": kind})
    said = verdict_of(tmp_path)["Real time, Dedicated"]
    assert said.mark == mark
    assert f"{printed} ms" in said.why


def test_a_likeness_just_below_a_limit_is_not_printed_as_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for condition in ("non_engine", "dedicated"):
        measure(tmp_path, condition, 30.0)
    monkeypatch.setattr("msb.report.verdict.likeness", lambda *_: Likeness(34.96, 3, 3))
    found = verdict_of(tmp_path)[SHADED]
    assert (found.mark, "34.9 dB between" in found.why) == ("WITH CARE", True), found


PNG = b"\x89PNG\r\n\x1a\nwhatever"
IN_PAGE = "data:image/png;base64,iVBORw0KGgp3aGF0ZXZlcg=="


def written(root: Path, pictures: dict[str, bytes] | None = None, **parts: Any) -> None:
    """Write the record of an exported mesh with some of its keys, and pictures beside it."""
    path = write(root, make_result("capture", "desk", "mesh_splatting", "exported_mesh"), **parts)
    for name, content in (pictures or {}).items():
        picture = path.parent / name
        picture.parent.mkdir()
        picture.write_bytes(content)


def page(root: Path, start: str, end: str = "\0") -> str:
    """Return the asset's page between two texts."""
    files = report_files(build_report(read_results(root), pictures=False), formats=("html",))
    (text,) = (data.decode() for name, data in files.items() if name.startswith("verdict-"))
    return text.partition(start)[2].partition(end)[0]


def tried(root: Path) -> str:
    return page(root, "What happened when it was tried")


def repaired(root: Path) -> str:
    return page(root, "What would make it usable, and what that costs", "Where the numbers are from")


def test_the_page_shows_outcome_reason_and_picture(tmp_path: Path) -> None:
    written(tmp_path, {"trial/uv.png": PNG}, trial=trial(TASK))
    assert "&lt;9&gt; charts (1.2 s)" in tried(tmp_path)
    assert IN_PAGE in tried(tmp_path)


@pytest.mark.parametrize(("content", "name"), [(b"GIF89a", "uv.png"), (b"", "../../uv.png")])
def test_a_picture_that_is_none_is_left_out(tmp_path: Path, content: bytes, name: str) -> None:
    written(tmp_path, {"trial/uv.png": content}, trial=trial({**TASK, "picture": name}))
    assert "image/png" not in page(tmp_path, "<html")


def test_the_page_names_the_free_way_first_and_then_what_a_better_one_costs(tmp_path: Path) -> None:
    free = way("orient,pair", verdict_after="limited", edges_cut=7, picture="orient-pair.png")
    looks = {"standard": {"psnr": 34.56, "same": False, "why": None}, "dedicated": SAME}
    costly = way("drop", verdict_after="ok", faces_kept=75, looks=looks, trials_passed_after=3)
    failed = {"strategy": "cut by igl", "plan": ["cut"], "peer": "igl", "why": "PEER_FAILED: it <died>"}
    found = repairs(way("as stored"), free, costly, failed)
    written(tmp_path, {"repairs/orient-pair.png": PNG}, repairs=found)
    text = repaired(tmp_path)
    first, second = (text.index(f"With {plan} ") for plan in ("orient,pair", "drop"))
    assert first < text.index("--plan orient,pair</code>") < second
    for value in ("LIMITED", "75 %", "34.6 dB", "3 of 3 tasks"):
        assert value in text
    assert "it &lt;died&gt;" in text
    assert text.count(IN_PAGE) == 1


def test_where_nothing_was_tried_the_page_has_the_commands(tmp_path: Path) -> None:
    written(tmp_path)
    assert "<code>msb trial " in page(tmp_path, "<html")
    assert "<code>msb bake " in page(tmp_path, "<html")
    assert "<code>msb repair --compare " in repaired(tmp_path)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    bakes(tmp_path)
    return tmp_path


def test_bakes_stand_after_the_tiers_under_their_own_names() -> None:
    names = ["exported_mesh", "baked/b", "standard/wgpu", "non_engine", "standard"]
    order = ["non_engine", "standard", "standard/wgpu", "baked/b", "exported_mesh"]
    assert sorted(names, key=condition_order) == order
    assert condition_title("baked/ceiling") == "Baked, ceiling"


@pytest.mark.slow
def test_every_format_and_page_has_the_parts_of_the_loss(root: Path) -> None:
    files = report_files(build_report(read_results(root)))
    for suffix in ("md", "tex", "csv", "json"):
        assert b"anew" in files[f"tables/loss_split-capture.{suffix}"]
        assert b"as shipped" in files[f"tables/bakes-capture.{suffix}"]
    assert b"Where the loss is" in files["report.md"]
    assert b"figures/loss_split-capture.svg" in files["report.md"]
    assert files["figures/loss_split-capture.pdf"].startswith(b"%PDF")
    assert b'id="loss_split-capture"' in files["index.html"]
    (page,) = [text for name, text in files.items() if name.startswith("verdict-")]
    assert b"anew" in page


def test_without_bakes_nothing_of_it_is_said(tmp_path: Path) -> None:
    for condition in ("dedicated", "standard"):
        measure(tmp_path, condition, 20.0)
    report = build_report(read_results(tmp_path))
    assert not report.numbers.splits
    assert "bakes" not in [section.name for section in report.sections]
    assert Key("capture", "desk", "two_dts", "standard", "psnr_16") not in report.numbers.values
