"""What would make a mesh usable, on the asset's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from msb.errors import InputError
from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from msb.trial.repairs import Row
from tests.report.documents import SAME, repairs, way
from tests.report.factory import make_result, write

HEADING = "What would make it usable, and what that costs"


def written(folder: Path, *ways: dict[str, Any]) -> Path:
    made = make_result("capture", "desk", "mesh_splatting", "exported_mesh")
    return write(folder, made, repairs=repairs(*ways))


def page(folder: Path) -> str:
    files = report_files(build_report(read_results(folder), pictures=False), formats=("html",))
    (text,) = (data.decode() for name, data in files.items() if name.startswith("verdict-"))
    return text.partition(HEADING)[2].partition("Where the numbers are from")[0]


def test_the_page_names_the_free_way_first_and_then_what_a_better_one_costs(tmp_path: Path) -> None:
    free = way("orient,pair", verdict_after="limited", edges_cut=7, picture="orient-pair.png")
    looks = {"standard": {"psnr": 34.56, "same": False, "why": None}, "dedicated": SAME}
    costly = way("drop", verdict_after="ok", faces_kept=75, looks=looks, trials_passed_after=3)
    failed = Row("cut by igl", ("cut",), "igl", why="PEER_FAILED: it <died>").to_dict()
    place = written(tmp_path, way("as stored"), free, costly, failed).parent / "repairs"
    place.mkdir()
    (place / "orient-pair.png").write_bytes(b"\x89PNG\r\n\x1a\nwhatever")
    text = page(tmp_path)
    first = text.index(
        "With orient,pair nothing visible changes, and the verdict is LIMITED instead of BAD; "
    )
    second = text.index("With drop the mesh keeps 75 % of its faces, looks 34.6 dB like the original, ")
    assert first < text.index("-o repaired.triasset --plan orient,pair</code>") < second
    assert "3 of 3 tasks work, 1 before." in text
    assert "PEER_FAILED: it &lt;died&gt;" in text
    assert text.count("data:image/png;base64,iVBORw0KGgp3aGF0ZXZlcg==") == 1


def test_where_no_way_helps_the_page_says_so(tmp_path: Path) -> None:
    written(tmp_path, way("as stored"), way("orient,pair"))
    assert "None of the ways that were tried gives a better verdict" in page(tmp_path)


def test_where_no_repair_was_tried_the_page_has_the_command(tmp_path: Path) -> None:
    write(tmp_path, make_result("capture", "desk", "mesh_splatting", "exported_mesh"))
    assert "<code>msb repair --compare " in page(tmp_path)


@pytest.mark.parametrize(
    ("changes", "pointer"),
    [
        ({"strategy": "orient"}, "/repairs/strategies"),
        ({"components": "4"}, "/repairs/strategies/0/components"),
        ({"verdict_after": "fine"}, "/repairs/strategies/0/verdict_after"),
        ({"looks": {"standard": SAME}}, "/repairs/strategies/0/looks/dedicated"),
        ({"trials": ["uv"]}, "/repairs/strategies/0/trials"),
        ({"cuts": 1}, "/repairs/strategies/0/cuts"),
        ({"why": "it died"}, "/repairs/strategies/0/faces_kept"),
    ],
)
def test_repairs_that_are_none_are_refused(tmp_path: Path, changes: dict[str, Any], pointer: str) -> None:
    written(tmp_path, way("as stored", **changes))
    with pytest.raises(InputError) as caught:
        read_results(tmp_path)
    assert (caught.value.code, caught.value.pointer) == ("RECORD_INVALID", pointer)
