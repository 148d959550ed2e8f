"""The verdict on an asset and its page: appearance, speed, trial tasks, repairs and bakes."""

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
from msb.report.verdict import Similarity
from tests.report.factory import (
    SAME,
    TASK,
    VIEWS,
    make_result,
    measure,
    repairs,
    strategy_json,
    trial,
    update_hashes,
    verdict_of,
    write,
)
from tests.report.test_golden import bakes

STANDARD, DEDICATED = "Standard-tier mesh, any engine", "Model with its native shaders (Dedicated)"


@pytest.mark.parametrize(("loss", "mark"), [(-0.2, "YES"), (0.99, "YES"), (1.0, "WITH CARE"), (3.0, "NO")])
def test_without_files_appearance_is_judged_by_the_loss_of_psnr(
    tmp_path: Path, loss: float, mark: str
) -> None:
    measure(tmp_path, "non_engine", 20.0, renderer={"kind": "msb_reference"})
    measure(tmp_path, "dedicated", 20.0 - loss)
    statements = verdict_of(tmp_path)
    assert statements[DEDICATED].mark == mark
    assert f"{abs(loss):.2f} dB" in statements[DEDICATED].why
    assert statements[STANDARD].mark == "UNKNOWN"


@pytest.mark.parametrize(
    ("noise", "psnr", "mark", "value"),
    [
        (0, (30.0, 30.0), "YES", ": 100.0 dB"),
        (2, (30.0, 30.0), "YES", ": 4"),
        (9, (30.0, 34.0), "WITH CARE", "4.00 dB better"),
        (60, (30.0, 30.0), "NO", ": 1"),
        (60, (6.71, 7.26), "UNKNOWN", "6.71 dB"),
        (0, (30.0, 20.0), "YES", "10.00 dB worse"),
        (0, (30.0, 30.001), "YES", "no loss"),
    ],
)
def test_appearance_is_judged_by_the_two_renderings(
    tmp_path: Path, noise: int, psnr: tuple[float, float], mark: str, value: str
) -> None:
    random = np.random.default_rng(3)
    picture = random.integers(70, 180, (64, 96, 3))
    for condition, recorded, change in zip(("non_engine", "dedicated"), psnr, (0, noise), strict=True):
        file = Results(tmp_path).record(measure(tmp_path, condition, recorded).cell)
        for name in VIEWS:
            place = (file.parent / "images" / name).with_suffix(".png")
            place.parent.mkdir(parents=True, exist_ok=True)
            changed = picture + random.integers(-change, change + 1, picture.shape)
            Image.fromarray(changed.astype(np.uint8)).save(place)
        update_hashes(file)
    dedicated = verdict_of(tmp_path)[DEDICATED]
    assert (dedicated.mark, value in dedicated.why) == (mark, True), dedicated


@pytest.mark.parametrize("pictures", [True, False])
def test_without_native_renderings_standard_is_compared_with_dedicated(
    tmp_path: Path, pictures: bool
) -> None:
    for condition, psnr in (("dedicated", 30.0), ("standard", 28.5)):
        measure(tmp_path, condition, psnr, images=pictures)
    statements = verdict_of(tmp_path)
    standard = statements[STANDARD]
    assert standard.mark == "WITH CARE"
    assert (standard.why.count(" dB between ") == 1) is pictures
    assert "1.50 dB worse" in standard.why
    assert statements[DEDICATED].mark == "UNKNOWN"


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
def test_real_time_depends_on_p95_and_no_time_rounds_to_a_limit(
    tmp_path: Path, p95: float, kind: str, mark: str, printed: str
) -> None:
    measure(tmp_path, "dedicated", timing={"p95_ms": p95, "device_kind": kind})
    statement = verdict_of(tmp_path)["Real time, Dedicated"]
    assert statement.mark == mark
    assert f"{printed} ms" in statement.why


def test_a_similarity_just_below_a_limit_does_not_round_to_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for condition in ("non_engine", "dedicated"):
        measure(tmp_path, condition, 30.0)
    monkeypatch.setattr("msb.report.verdict.measure_similarity", lambda *_: Similarity(34.96, 3, 3))
    dedicated = verdict_of(tmp_path)[DEDICATED]
    assert (dedicated.mark, "34.9 dB between" in dedicated.why) == ("WITH CARE", True), dedicated


PNG = b"\x89PNG\r\n\x1a\nwhatever"
IN_PAGE = "data:image/png;base64,iVBORw0KGgp3aGF0ZXZlcg=="


def write_mesh_record(root: Path, pictures: dict[str, bytes] | None = None, **parts: Any) -> None:
    """Write the record of an exported mesh with `parts` in place of its keys, and images beside it."""
    path = write(root, make_result("capture", "desk", "mesh_splatting", "exported_mesh"), **parts)
    for name, content in (pictures or {}).items():
        picture = path.parent / name
        picture.parent.mkdir()
        picture.write_bytes(content)


def page(root: Path, start: str, end: str = "\0") -> str:
    """Return the part of the asset's page between two texts."""
    files = report_files(build_report(read_results(root), pictures=False), formats=("html",))
    (text,) = (data.decode() for name, data in files.items() if name.startswith("verdict-"))
    return text.partition(start)[2].partition(end)[0]


def repair_section(root: Path) -> str:
    return page(root, "<h2>Repair strategies", "<h2>Provenance")


def test_the_page_shows_outcome_reason_and_image_of_a_task(tmp_path: Path) -> None:
    write_mesh_record(tmp_path, {"trial/uv.png": PNG}, trial=trial(TASK))
    section = page(tmp_path, "<h2>Trial tasks")
    assert "&lt;9&gt; charts (1.2 s)" in section
    assert IN_PAGE in section


@pytest.mark.parametrize(("content", "name"), [(b"GIF89a", "uv.png"), (b"", "../../uv.png")])
def test_a_file_that_is_not_a_png_is_left_out(tmp_path: Path, content: bytes, name: str) -> None:
    write_mesh_record(tmp_path, {"trial/uv.png": content}, trial=trial({**TASK, "picture": name}))
    assert "image/png" not in page(tmp_path, "<html")


def test_the_page_names_first_the_invisible_repair_and_then_a_better_one(tmp_path: Path) -> None:
    free = strategy_json("orient,pair", verdict_after="limited", edges_cut=7, picture="orient-pair.png")
    looks = {"standard": {"psnr": 34.56, "same": False, "why": None}, "dedicated": SAME}
    costly = strategy_json("drop", verdict_after="ok", faces_kept=75, looks=looks, trials_passed_after=3)
    failed = {"strategy": "cut by igl", "plan": ["cut"], "peer": "igl", "why": "PEER_FAILED: it <died>"}
    comparison = repairs(strategy_json("as stored"), free, costly, failed)
    write_mesh_record(tmp_path, {"repairs/orient-pair.png": PNG}, repairs=comparison)
    text = repair_section(tmp_path)
    first, second = (text.index(f"With {plan} ") for plan in ("orient,pair", "drop"))
    assert first < text.index("--plan orient,pair</code>") < second
    for value in ("LIMITED", "75 %", "34.6 dB", "3 of 3 tasks"):
        assert value in text
    assert "it &lt;died&gt;" in text
    assert text.count(IN_PAGE) == 1


def test_without_trials_the_page_names_the_commands(tmp_path: Path) -> None:
    write_mesh_record(tmp_path)
    assert "<code>msb trial " in page(tmp_path, "<html")
    assert "<code>msb bake " in page(tmp_path, "<html")
    assert "<code>msb repair --compare " in repair_section(tmp_path)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    bakes(tmp_path)
    return tmp_path


def test_bakes_follow_the_tiers_with_their_names() -> None:
    names = ["exported_mesh", "baked/b", "standard/wgpu", "non_engine", "standard"]
    order = ["non_engine", "standard", "standard/wgpu", "baked/b", "exported_mesh"]
    assert sorted(names, key=condition_order) == order
    assert condition_title("baked/ceiling") == "Baked, ceiling"


@pytest.mark.slow
def test_every_format_has_the_parts_of_the_loss(root: Path) -> None:
    files = report_files(build_report(read_results(root)))
    for suffix in ("md", "tex", "csv", "json"):
        assert b"fitted" in files[f"tables/loss_split-capture.{suffix}"]
        assert b"as exported" in files[f"tables/bakes-capture.{suffix}"]
    assert b"## Parts of the loss" in files["report.md"]
    assert b"figures/loss_split-capture.svg" in files["report.md"]
    assert files["figures/loss_split-capture.pdf"].startswith(b"%PDF")
    assert b'id="loss_split-capture"' in files["index.html"]
    (page,) = [text for name, text in files.items() if name.startswith("verdict-")]
    assert b"(fitted)" in page


def test_without_bakes_there_is_no_section_on_them(tmp_path: Path) -> None:
    for condition in ("dedicated", "standard"):
        measure(tmp_path, condition, 20.0)
    report = build_report(read_results(tmp_path))
    assert not report.numbers.splits
    assert "bakes" not in [section.name for section in report.sections]
    assert Key("capture", "desk", "two_dts", "standard", "psnr_16") not in report.numbers.values
