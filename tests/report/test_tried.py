"""What was tried on a mesh, and what would make it usable, on the asset's page."""

from pathlib import Path
from typing import Any

import pytest

from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.report.documents import SAME, TASK, repairs, trial, way
from tests.report.factory import make_result, write

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
