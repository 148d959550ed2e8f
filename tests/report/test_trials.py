"""What was tried on a mesh, on the asset's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from msb.errors import InputError
from msb.report.build import build_report
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.report.documents import TASK, trial
from tests.report.factory import make_result, write


def written(folder: Path, **changes: Any) -> Path:
    made = make_result("capture", "desk", "mesh_splatting", "exported_mesh")
    return write(folder, made, trial=trial({**TASK, **changes}))


def page(folder: Path) -> str:
    files = report_files(build_report(read_results(folder), pictures=False), formats=("html",))
    (text,) = (data.decode() for name, data in files.items() if name.startswith("verdict-"))
    return text


def test_the_page_shows_outcome_reason_and_picture(tmp_path: Path) -> None:
    place = written(tmp_path).parent / "trial"
    place.mkdir()
    (place / "uv.png").write_bytes(b"\x89PNG\r\n\x1a\nwhatever")
    text = page(tmp_path).partition("What happened when it was tried")[2]
    assert "9 charts; it falls into &lt;9&gt; charts (1.2 s)." in text
    assert "data:image/png;base64,iVBORw0KGgp3aGF0ZXZlcg==" in text


@pytest.mark.parametrize("content", [b"GIF89a", None])
def test_a_picture_that_is_none_is_left_out(tmp_path: Path, content: bytes | None) -> None:
    place = written(tmp_path, picture="../../uv.png" if content is None else "uv.png").parent / "trial"
    place.mkdir()
    (place / "uv.png").write_bytes(content or b"")
    assert "image/png" not in page(tmp_path)


def test_where_nothing_was_tried_the_page_has_the_command(tmp_path: Path) -> None:
    write(tmp_path, make_result("capture", "desk", "mesh_splatting", "exported_mesh"))
    assert "<code>msb trial " in page(tmp_path)


@pytest.mark.parametrize(
    ("changes", "pointer"),
    [
        ({"outcome": "good"}, "/trial/trials/0/outcome"),
        ({"title": 3}, "/trial/trials/0/title"),
        ({"seconds": None}, "/trial/trials/0/seconds"),
    ],
)
def test_trials_that_are_none_are_refused(tmp_path: Path, changes: dict[str, Any], pointer: str) -> None:
    written(tmp_path, **changes)
    with pytest.raises(InputError) as caught:
        read_results(tmp_path)
    assert (caught.value.code, caught.value.pointer) == ("RECORD_INVALID", pointer)
