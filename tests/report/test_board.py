"""Submissions contain no private data; the board shows all of them and rejects invalid ones."""

import hashlib
import io
import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from msb.bench.documents import (
    STORED,
    AuditDocument,
    BakeDocument,
    ChamferDocument,
    RepairDocument,
    TrialDocument,
)
from msb.bench.records import File, Reason, RendererTiming, Result, Training
from msb.bench.submission import ABOUT, About, Submission, read_submission, write_submission
from msb.errors import InputError
from msb.report.board import _name_submissions, build_board, submitted_pictures
from msb.report.collect import collect
from msb.report.pages import report_files
from msb.report.results import LoadedResult, read_results, result_set
from tests.cli.conftest import Msb
from tests.report.factory import (
    AUDIT,
    SAME,
    TASK,
    bake,
    chamfer,
    make_result,
    repairs,
    strategy_json,
    trial,
    write_results,
)

Change = Callable[[dict[str, bytes]], Any]
"""A function that changes the members of an archive, given as contents by name."""


@pytest.fixture(scope="module")
def submission(small: Path) -> bytes:
    results = read_results(small)
    return write_submission("Our lab", [loaded.result for loaded in results], submitted_pictures(results))


def test_equal_results_give_equal_bytes(small: Path, submission: bytes, tmp_path: Path) -> None:
    results = read_results(small)
    records = [loaded.result for loaded in results]
    assert write_submission("Our lab", records[::-1], submitted_pictures(results)) == submission
    (tmp_path / "a.zip").write_bytes(submission)
    back = read_submission(tmp_path / "a.zip")
    assert back.about.name == "Our lab"
    assert {record.cell.names for record in back.records} == {record.cell.names for record in records}
    assert 0 < len(back.pictures) <= 200


def test_a_submission_holds_no_paths_and_no_user_names(tmp_path: Path) -> None:
    secret = "/home/alice/my scans/desk"
    lost = Reason(code="X", message=f"no {secret}/a b")
    looks = {"standard": SAME, "dedicated": {**SAME, "same": False, "why": secret}}
    plan = strategy_json("orient", looks=looks, picture="alice.png")
    record = make_result(
        "capture",
        "desk",
        "two_dts",
        "non_engine",
        **dict.fromkeys(("asset", "checkpoint", "renders"), File(path=secret, bytes=1, sha256="0" * 64)),
        training=Training(seconds=1.0, peak_memory_bytes=None, source=secret),
        renderer_timing=RendererTiming(frames=1, seconds=1.0, device="A GPU", timed="by Alice's script"),
        device={"host": "alice", "device": {"name": "A GPU", "path": secret}},
        audit=AuditDocument.of({**AUDIT, "path": secret}),
        trial=TrialDocument.of(trial({**TASK, "why": secret, "numbers": {"file": secret}})),
        repairs=RepairDocument.of(repairs(strategy_json(STORED), plan, {"strategy": "cut", "why": secret})),
        chamfer=ChamferDocument.of({**chamfer(1), "mesh": secret}),
        bake=BakeDocument.of({**OF_A_BAKE, "output": secret, "lods": [{"output": secret}]}),
        reasons={"timing": lost},
        reason=lost,
        inputs={"quality": {"photographs": "0" * 16, secret: "1"}},
    )
    data = write_submission("Our lab", [record], [])
    for word in ("alice", "scans", "/home"):
        assert word not in data.decode("latin-1").lower()
    (tmp_path / "a.zip").write_bytes(data)
    (back,) = read_submission(tmp_path / "a.zip").records
    before, after = (
        collect(result_set([LoadedResult(result, tmp_path, tmp_path)])).values for result in (record, back)
    )
    assert {key: number.value for key, number in after.items()} == {
        key: number.value for key, number in before.items()
    }


def rebuild(
    data: bytes, change: Change, *, compression: int = zipfile.ZIP_STORED, update_hashes: bool = True
) -> bytes:
    """Return the archive `data` after a change of its members."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    if update_hashes:
        about = json.loads(members[ABOUT])
        about["files"] = {n: hashlib.sha256(b).hexdigest() for n, b in members.items() if n != ABOUT}
        members[ABOUT] = json.dumps(about).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def edit(name: str, *keys: str | int, value: Any) -> Change:
    """Return a change that sets a value in the JSON of a member."""

    def change(members: dict[str, bytes]) -> None:
        data = json.loads(members[name])
        inner = data
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        members[name] = json.dumps(data).encode()

    return change


FIRST = "records/00000.json"
MESH = "records/00001.json"
IMAGE = ("quality", "images", 0)
OF_A_BAKE = json.loads(bake("kept")["bake"].to_json())


def change_bake(**changes: float) -> dict[str, Any]:
    photographs = OF_A_BAKE["psnr"]["photographs"] | changes
    return {**OF_A_BAKE, "psnr": {"native": None, "photographs": photographs}}


NO_VGG = [{"name": "lpips_vgg", "weights": {"heads": {"known": None}}}]


HOSTILE = [
    (edit(FIRST, "quality", "psnr", value=99.0), {"update_hashes": False}, ": records/"),
    (edit(FIRST, "quality", "psnr", value=99.0), {}, "/quality/psnr"),
    (edit(FIRST, "schema", value="msb.result/9"), {}, "/schema"),
    (edit(ABOUT, "schema", value="msb.submission/2"), {}, "/schema"),
    (edit(ABOUT, "extra", value=1), {}, "/extra"),
    (lambda members: members.pop(ABOUT), {"update_hashes": False}, "submission.json"),
    (lambda members: members.pop(FIRST), {"update_hashes": False}, "records/00000.json"),
    (lambda members: members.update({"../evil.json": b"{}"}), {"update_hashes": False}, "../evil.json"),
    (lambda members: members.update({"pictures/9999.jpg": b"x" * (2 << 20)}), {}, "pictures/9999.jpg"),
    (lambda members: members.update({"records/09999.json": members[FIRST]}), {}, "two records"),
    (lambda members: None, {"compression": zipfile.ZIP_DEFLATED}, "compressed"),
    (edit(FIRST, *IMAGE, "psnr", value=5000.0), {}, "/images/0/psnr"),
    (edit(FIRST, *IMAGE, "ssim", value=7.0), {}, "/images/0/ssim"),
    (edit(FIRST, *IMAGE, "lpips", value=-3.0), {}, "/images/0/lpips"),
    (edit(FIRST, *IMAGE, "lpips", value=1.7e308), {}, "/images/0/lpips"),
    (edit(FIRST, "timing", "p50_ms", value=1.7e308), {}, "/timing/p50_ms"),
    (edit(FIRST, "timing", "fps", value=0), {}, "/timing/fps"),
    (edit(FIRST, "timing", "fps", value=1e99), {}, "1e+99"),
    (edit(FIRST, "timing", "p95_ms", value=0), {}, "p95_ms"),
    (edit(MESH, "audit", "metrics", "nonmanifold_edge_ratio", value=-3), {}, "nonmanifold_edge_ratio -3"),
    (edit(MESH, "audit", "metrics", "nonmanifold_edge_ratio", value=50), {}, "nonmanifold_edge_ratio 50"),
    (edit(MESH, "audit", "counts", "faces", value=-7), {}, "faces -7"),
    (edit(MESH, "chamfer", value=chamfer(-1.0)), {}, "/chamfer/overall"),
    (edit(FIRST, "bake", value=change_bake(after=9999.0)), {}, "/after"),
    (edit(FIRST, "bake", value=change_bake(after_16=-4000.0)), {}, "/after_16"),
    (edit(FIRST, "quality", "metrics", value=NO_VGG), {}, "/metrics/0/weights"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "options", "where"), HOSTILE)
def test_submissions_that_fail_verification_are_rejected(
    submission: bytes, tmp_path: Path, change: Change, options: dict[str, Any], where: str
) -> None:
    path = tmp_path / "bad.zip"
    path.write_bytes(rebuild(submission, change, **options))
    with pytest.raises(InputError, match="RECORD_INVALID") as caught:
        read_submission(path)
    assert where in str(caught.value)


@pytest.mark.parametrize("psnr", [9999.0, -5.0, None])
def test_images_must_be_jpegs_with_the_psnr_of_a_record(
    submission: bytes, tmp_path: Path, psnr: float | None
) -> None:
    with zipfile.ZipFile(io.BytesIO(submission)) as archive:
        pictures = json.loads(archive.read(ABOUT))["pictures"]
        widths = [Image.open(io.BytesIO(archive.read(about["file"]))).width for about in pictures]
        assert max(widths) <= 480
    number = next(number for number, about in enumerate(pictures) if about["method"])
    path = tmp_path / "bad.zip"
    for change in (
        edit(ABOUT, "pictures", number, "psnr", value=psnr),
        lambda members: members.update({"pictures/0000.jpg": b"GIF89a"}),
    ):
        path.write_bytes(rebuild(submission, change))
        with pytest.raises(InputError, match=r"RECORD_INVALID: .*pictures/"):
            build_board([read_submission(path)])


def test_truncated_files_and_other_files_are_rejected(submission: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.zip"
    for data in (b"", b"PK", submission[:-9], submission + b"x", b"x" + submission):
        path.write_bytes(data)
        with pytest.raises(InputError, match="RECORD_INVALID"):
            read_submission(path)


@pytest.mark.slow
def test_board_has_the_rows_of_all_submitters_and_of_the_paper(small: Path, tmp_path: Path, msb: Msb) -> None:
    theirs = write_results(tmp_path / "theirs", datasets=["tanksandtemples"], methods=["two_dts"])
    ours = tmp_path / "ours.zip"
    msb("submit", small, "-o", ours, "--name", "Our <b>lab</b>", status=0)
    msb("submit", theirs, "-o", tmp_path / "theirs.zip", "--name", "Theirs", status=0)
    files = [read_submission(tmp_path / f"{name}.zip") for name in ("ours", "theirs")]
    board = build_board(files)
    rows = _rows(board)
    mean = [row for row in rows if row["labels"] == ("Tanks and Temples", "Mean", "2DTS")]
    dedicated = [row for row in mean if row["Condition"] == "Dedicated"]
    assert [row["From"] for row in dedicated] == ["Our <b>lab</b>", "Theirs", "the paper"]
    # the means of the synthetic results equal the paper's means
    assert len({row["PSNR ↑"] for row in dedicated}) == 1
    truck = next(row for row in rows if row["labels"][1:] == ("truck", "2DTS") and row["From"] == "Theirs")
    assert truck["Model"] == hashlib.sha256(b"tanksandtemples/truck/two_dts").hexdigest()[:12]
    assert not any(row["From"] == "the paper" for row in _rows(build_board(files, with_paper=False)))
    page = report_files(board, formats=["html"])["index.html"].decode()
    assert "Our &lt;b&gt;lab" in page
    assert "<b>lab" not in page
    assert page.count("data:image/jpeg") > 0
    assert all(file.sha256 in page for file in files)
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


def _rows(board: Any) -> list[dict[str, Any]]:
    table = board.tables["board"]
    names = [column.title for column in table.columns]
    return [
        {**dict(zip(names, (cell.text for cell in row.cells), strict=True)), "labels": row.labels}
        for row in table.rows
    ]


@pytest.mark.slow
def test_board_by_command(small: Path, tmp_path: Path, msb: Msb) -> None:
    ours = tmp_path / "ours.zip"
    document = msb("submit", "--json", "-", small, "-o", ours, "--name", "Our lab").json
    assert document["sha256"] == hashlib.sha256(ours.read_bytes()).hexdigest()
    msb("report", ours, "-o", tmp_path / "board", "--format", "html,csv", status=0)
    names = {path.name for path in (tmp_path / "board").iterdir()}
    assert names >= {"index.html", "tables", "report.json"}
    msb("report", ours).ends(2, "USAGE: ")
    msb("report", ours, small, "-o", tmp_path / "x").ends(2, f"USAGE: {small}: ")
    msb("report", ours, ours, "-o", tmp_path / "x").ends(2, f"USAGE: {ours}: ")
    msb("submit", small, "-o", tmp_path / "x.zip", "--name", " ").ends(2, "USAGE: --name: ")
    ours.write_bytes(ours.read_bytes()[:-1])
    msb("report", ours, "-o", tmp_path / "x").ends(3, f"RECORD_INVALID: {ours}: ")
    assert not (tmp_path / "x").exists()


def test_a_note_names_submissions_with_different_photographs(tmp_path: Path) -> None:
    files = []
    for name, key in (("one", "a" * 16), ("two", "b" * 16)):
        record = make_result(
            "mipnerf360", "garden", "two_dts", "dedicated", inputs={"quality": {"photographs": key}}
        )
        (tmp_path / f"{name}.zip").write_bytes(write_submission("Lab", [record], []))
        files.append(read_submission(tmp_path / f"{name}.zip"))
    (note,) = build_board(files).notes
    first, second = (f"Lab ({file.sha256[:6]})" for file in files)
    assert f"{first} and {second}" in note


def test_submitters_of_equal_names_get_different_names(tmp_path: Path) -> None:
    def submit(name: str, scene: str) -> Submission:
        (tmp_path / "a.zip").write_bytes(
            write_submission(name, [make_result("mipnerf360", scene, "two_dts", "dedicated")], [])
        )
        return read_submission(tmp_path / "a.zip")

    two = [submit("Lab", "garden"), submit("Lab", "room")]
    posing = [submit(f"Lab ({two[0].sha256[:6]})", "counter"), submit("The paper", "bonsai")]
    board = build_board([*two, *posing])
    names = [name for name, _ in board.submissions]
    assert names == [
        *(f"Lab ({submission.sha256[:7]})" for submission in two),
        posing[0].about.name,
        f"The paper ({posing[1].sha256[:7]})",
    ]
    assert {row["From"] for row in _rows(board)} == {*names, "the paper"}


def test_names_that_look_the_same_are_distinguished() -> None:
    for name in ("The  paper", "the\u00a0paper", "the pa\u034fper", "the paper\u2800", "\uff54he paper"):
        (unique,) = _name_submissions([_make_submission(name)])
        assert unique.endswith(" (000000)")
    names = ["Lab X", "Lab  X", "lab x\u200b", "Lab Y", "\u3164"]
    unique = _name_submissions([_make_submission(name, str(number)) for number, name in enumerate(names)])
    assert unique == ["Lab X (000000)", "Lab  X (111111)", "lab x (222222)", "Lab Y", "4" * 12]


def _make_submission(name: str, digit: str = "0", records: tuple[Result, ...] = ()) -> Submission:
    about = About(name=name, tool_version="1", code_sha256="0" * 64, commands=(), files={}, pictures=())
    return Submission(Path("x.zip"), digit * 64, about, records, {})


def test_the_work_grows_linearly_with_the_records() -> None:
    record = make_result("capture", "desk", "two_dts", "dedicated")

    def calls(count: int) -> int:
        """Return the number of function calls for a board of `count` records."""
        cells = (record.cell.model_copy(update={"scene": f"n{number}"}) for number in range(count))
        sent = _make_submission(
            "Lab", records=tuple(record.model_copy(update={"cell": cell}) for cell in cells)
        )
        events: list[str] = []
        before = sys.getprofile()
        sys.setprofile(lambda _frame, event, _argument: events.append(event))
        try:
            build_board([sent])
        finally:
            sys.setprofile(before)
        return events.count("call")

    calls(1)  # fill caches
    assert calls(80) < 2.1 * calls(40)
