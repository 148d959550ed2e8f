"""Submissions and their board: nothing private in a file, nothing believed that does not verify."""

from __future__ import annotations

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

from msb.bench.records import File, Reason, RendererTiming, Result, Training
from msb.bench.submission import ABOUT, About, Scrub, Submission, read_submission, write_submission
from msb.errors import InputError, UsageError
from msb.report.board import _names, build_board, submitted_pictures
from msb.report.pages import report_files
from msb.report.results import read_results
from tests.cli.conftest import Msb, msb
from tests.report.documents import chamfer
from tests.report.factory import bake, make_result, write, write_results

__all__ = ["msb"]  # the fixture
HOME = "/home/alice"
PATH = f"{HOME}/my scans/desk"
Change = Callable[[dict[str, bytes]], Any]
"""What is done to the members of an archive, by their names."""


@pytest.fixture
def alice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make this machine one with an owner and a name."""
    monkeypatch.setattr("getpass.getuser", lambda: "alice")
    monkeypatch.setattr("platform.node", lambda: "wonderland.example.org")
    monkeypatch.setattr(Path, "home", lambda: Path(HOME))


@pytest.fixture(scope="module")
def submission(small: Path) -> bytes:
    found = read_results(small)
    return write_submission("Our lab", [each.result for each in found], submitted_pictures(found))


def private_results(root: Path) -> Path:
    """Write records in which paths and names are wherever a run puts them."""
    track = {
        "schema": "msb.track/1", "command": ["python", f"{PATH}/train.py", "-s", "scans/desk", "--eval"],
        "started": "", "ended": "", "seconds": 1.0, "exit_status": 0, "peak_gpu_memory_bytes": None,
        "gpu_source": None, "gpu_reason": None, "gpus": [], "peak_host_memory_bytes": None,
        "interval_seconds": 0.2, "machine": {"host": "wonderland"}, "tool_version": "0",
    }  # fmt: skip
    (root / "track.json").write_text(json.dumps(track))
    record = make_result(
        "capture",
        "desk",
        "two_dts",
        "non_engine",
        asset=File(path=f"{PATH}/x.triasset", bytes=1, sha256="0" * 64),
        checkpoint=File(path="../alice/model", bytes=1),
        renders=File(path="C:\\Users\\alice\\renders", bytes=1),
        training=Training(seconds=1.0, peak_memory_bytes=None, source=str(root / "track.json")),
        renderer_timing=RendererTiming(frames=1, seconds=1.0, device="wonderland", timed="by Alice's script"),
        reasons={
            "timing": Reason(code="X", message=f"no {PATH}/a b and ~/x, nor scans/desk on Wonderland:1"),
            "trial": Reason(code="X", message="alice's 3 m/s"),
        },
    )
    write(root, record, images=True)
    return root


@pytest.mark.usefixtures("alice")
def test_nothing_in_it_says_where_or_who(tmp_path: Path) -> None:
    found = read_results(private_results(tmp_path))
    data = write_submission("Our lab", [each.result for each in found], submitted_pictures(found))
    text = data.decode("latin-1").lower()
    for word in ("alice", "wonderland", "scans", "users", str(tmp_path).lower(), "/home", "~/x"):
        assert word not in text, word
    about = json.loads(zipfile.ZipFile(io.BytesIO(data)).read(ABOUT))
    assert about["commands"] == [
        "msb track -- python withheld -s withheld --eval",
        "msb run --scene capture/desk --image-folder images_4 --non-engine renders two_dts",
    ]
    assert len(about["pictures"]) == 0  # one condition has no loss to show
    kept = make_result("mipnerf360", "garden", "two_dts", "dedicated").quality
    assert kept is not None
    said = "clamp to [0, 1], floor(255 x + 0.5) / 255; 3 m/s, N/A"
    assert Scrub().text(said) == said
    lods = {"lods": [{"output": "baked/x_lod1.glb", "faces": 1}], "cell": {"scene": "desk"}}
    assert Scrub().data(lods) == {**lods, "lods": [{"output": "withheld", "faces": 1}]}


@pytest.mark.usefixtures("alice")
def test_names_that_must_stay_are_refused(tmp_path: Path) -> None:
    record = make_result("scans", "alice_desk", "two_dts", "dedicated")
    with pytest.raises(UsageError, match="the scene of a record is called 'alice_desk', which holds a path"):
        write_submission("Our lab", [record], [])


def test_the_same_results_give_the_same_bytes(small: Path, submission: bytes, tmp_path: Path) -> None:
    found = read_results(small)
    records = [each.result for each in found]
    assert write_submission("Our lab", records[::-1], submitted_pictures(found)) == submission
    (tmp_path / "a.zip").write_bytes(submission)
    back = read_submission(tmp_path / "a.zip")
    assert back.about.name == "Our lab"
    assert {each.cell.names for each in back.records} == {each.cell.names for each in records}
    assert 0 < len(back.pictures) <= 200


def rebuilt(
    data: bytes, change: Callable[[dict[str, bytes]], None], *, how: int = 0, true: bool = True
) -> bytes:
    """Return the archive with other members, and with `true` hashes of them in its list."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    if true:
        about = json.loads(members[ABOUT])
        about["files"] = {n: hashlib.sha256(b).hexdigest() for n, b in members.items() if n != ABOUT}
        members[ABOUT] = json.dumps(about).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def edit(name: str, *keys: str | int, value: Any) -> Change:
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
LOUD = OF_A_BAKE["psnr"]["photographs"] | {"after": 9999.0}
FAINT = OF_A_BAKE["psnr"]["photographs"] | {"after_16": -4000.0}
NO_VGG = [{"name": "lpips_vgg", "weights": {"heads": {"known": None}}}]
HOSTILE = [
    (edit(FIRST, "quality", "psnr", value=99.0), {"true": False}, "is not the one that was submitted"),
    (edit(FIRST, "quality", "psnr", value=99.0), {}, "/quality/psnr: it is 99.0, and the mean of its images"),
    (edit(FIRST, "schema", value="msb.result/9"), {}, "/schema"),
    (edit(ABOUT, "schema", value="msb.submission/2"), {}, "/schema"),
    (edit(ABOUT, "extra", value=1), {}, "there is no such key"),
    (lambda members: members.pop(ABOUT), {"true": False}, "there is no submission.json"),
    (lambda members: members.pop(FIRST), {"true": False}, "records/00000.json is in its list or in the file"),
    (lambda members: members.update({"../evil.json": b"{}"}), {"true": False}, '"../evil.json" is none of'),
    (lambda members: members.update({"pictures/9999.jpg": b"x" * (2 << 20)}), {}, "1,048,576 are allowed"),
    (lambda members: members.update({"records/09999.json": members[FIRST]}), {}, "two records of one cell"),
    (lambda members: None, {"how": zipfile.ZIP_DEFLATED}, "is compressed"),
    (edit(FIRST, *IMAGE, "psnr", value=5000.0), {}, "/images/0/psnr: 5000 dB, and no PSNR is above 90.79"),
    (edit(FIRST, *IMAGE, "ssim", value=7.0), {}, "/images/0/ssim: 7, and no SSIM is above 1"),
    (edit(FIRST, *IMAGE, "ssim", value=-2.0), {}, "/images/0/ssim: -2, and no SSIM is below -1"),
    (edit(FIRST, *IMAGE, "lpips", value=-3.0), {}, "/images/0/lpips: -3, and no LPIPS is negative"),
    (lambda members: [edit(FIRST, "quality", "images", number, "lpips", value=1.7e308)(members)
                      for number in range(3)], {}, "/images/0/lpips: 1.7e+308 is no measurement"),
    (edit(FIRST, "timing", "p50_ms", value=1.7e308), {}, "/timing/p50_ms: 1.7e+308 is no measurement"),
    (edit(FIRST, "timing", "fps", value=0), {}, "/timing/fps: "),
    (edit(FIRST, "timing", "fps", value=1e99), {}, "s are no 1e+99 frames a second"),
    (edit(FIRST, "timing", "p95_ms", value=0), {}, "and p95_ms less"),
    (edit(MESH, "audit", "metrics", "nonmanifold_edge_ratio", value=-3), {}, "nonmanifold_edge_ratio -3"),
    (edit(MESH, "audit", "metrics", "nonmanifold_edge_ratio", value=50), {}, "nonmanifold_edge_ratio 50"),
    (edit(MESH, "audit", "metrics", "components", value=-7), {}, "no mesh has components -7"),
    (edit(MESH, "audit", "counts", "faces", value=-7), {}, "no mesh has faces -7"),
    (edit(MESH, "chamfer", value=chamfer(-1.0)), {}, "/chamfer/overall: "),
    (edit(FIRST, "bake", value=OF_A_BAKE | {"psnr": {"own": None, "photographs": LOUD}}), {}, "/after: "),
    (edit(FIRST, "bake", value=OF_A_BAKE | {"psnr": {"own": None, "photographs": FAINT}}), {}, "/after_16: "),
    (edit(FIRST, "bake", value=OF_A_BAKE | {"psnr": {}}), {}, "/bake/psnr/own: it is missing"),
    (edit(FIRST, "quality", "metrics", value=NO_VGG), {}, "/metrics/0/weights: it does not say which"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "how", "why"), HOSTILE)
def test_what_does_not_verify_is_refused(
    submission: bytes, tmp_path: Path, change: Change, how: dict[str, Any], why: str
) -> None:
    path = tmp_path / "bad.zip"
    path.write_bytes(rebuilt(submission, change, **how))
    with pytest.raises(InputError, match="RECORD_INVALID") as refused:
        read_submission(path)
    assert why in str(refused.value)


def test_files_that_are_cut_off_or_no_archive_are_refused(submission: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.zip"
    for data in (b"", b"PK", submission[:-9], submission + b"x", b"x" + submission):
        path.write_bytes(data)
        with pytest.raises(InputError, match="RECORD_INVALID"):
            read_submission(path)


def test_a_picture_that_is_none_is_refused(submission: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.zip"
    path.write_bytes(rebuilt(submission, lambda members: members.update({"pictures/0000.jpg": b"GIF89a"})))
    with pytest.raises(InputError, match=r"RECORD_INVALID: .*pictures/0000.jpg is no JPEG"):
        build_board([read_submission(path)])


@pytest.mark.parametrize("psnr", [9999.0, 1.7e308, -5.0, None])
def test_the_psnr_under_a_picture_is_that_of_its_record(
    submission: bytes, tmp_path: Path, psnr: float | None
) -> None:
    pictures = json.loads(zipfile.ZipFile(io.BytesIO(submission)).read(ABOUT))["pictures"]
    number = next(number for number, one in enumerate(pictures) if one["method"])
    path = tmp_path / "bad.zip"
    path.write_bytes(rebuilt(submission, edit(ABOUT, "pictures", number, "psnr", value=psnr)))
    with pytest.raises(InputError, match=r"RECORD_INVALID: .*the PSNR of pictures/.* is that of none of its"):
        build_board([read_submission(path)])


def test_board_has_everybody_s_rows_and_the_paper_s(small: Path, tmp_path: Path, msb: Msb) -> None:
    theirs = write_results(tmp_path / "theirs", datasets=["tanksandtemples"], methods=["two_dts"])
    ours = tmp_path / "ours.zip"
    msb("submit", small, "-o", ours, "--name", "Our <b>lab</b>", status=0)
    msb("submit", theirs, "-o", tmp_path / "theirs.zip", "--name", "Theirs", status=0)
    files = [read_submission(tmp_path / f"{name}.zip") for name in ("ours", "theirs")]
    board = build_board(files)
    table = board.tables["board"]
    places = [column.title for column in table.columns]
    rows = [
        {**dict(zip(places, (cell.text for cell in row.cells), strict=True)), "labels": row.labels}
        for row in table.rows
    ]
    mean = [row for row in rows if row["labels"] == ("Tanks and Temples", "Mean", "2DTS")]
    dedicated = [row for row in mean if row["Condition"] == "Dedicated"]
    assert [row["From"] for row in dedicated] == ["Our <b>lab</b>", "Theirs", "the paper"]
    assert len({row["PSNR ↑"] for row in dedicated}) == 1  # the made-up means are the paper's
    one = next(row for row in rows if row["labels"][1:] == ("truck", "2DTS") and row["From"] == "Theirs")
    assert one["Model"] == hashlib.sha256(b"tanksandtemples/truck/two_dts").hexdigest()[:12]
    assert not any(row["From"] == "the paper" for row in _rows(build_board(files, with_paper=False)))
    page = report_files(board, formats=["html"])["index.html"].decode()
    assert "Our &lt;b&gt;lab" in page
    assert "<b>lab" not in page
    assert page.count("data:image/jpeg") > 0
    assert all(each.sha256 in page for each in files)
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


def _rows(board: Any) -> list[dict[str, str]]:
    table = board.tables["board"]
    names = [column.title for column in table.columns]
    return [dict(zip(names, (cell.text for cell in row.cells), strict=True)) for row in table.rows]


@pytest.mark.slow
def test_boards_of_the_command(small: Path, tmp_path: Path, msb: Msb) -> None:
    ours = tmp_path / "ours.zip"
    said = msb("submit", "--json", "-", small, "-o", ours, "--name", "Our lab").json
    assert said["sha256"] == hashlib.sha256(ours.read_bytes()).hexdigest()
    made = msb("report", ours, "-o", tmp_path / "board", "--format", "html,csv")
    assert made.status == 0, made.err
    assert {path.name for path in (tmp_path / "board").iterdir()} == {"index.html", "tables", "report.json"}
    msb("report", ours).ends(2, "USAGE: say with -o where the board goes")
    msb("report", ours, small, "-o", tmp_path / "x").ends(2, f"USAGE: {small}: it is no submission")
    msb("report", ours, ours, "-o", tmp_path / "x").ends(2, f"USAGE: {ours}: it is the same submission")
    msb("submit", small, "-o", tmp_path / "x.zip", "--name", " ").ends(2, "USAGE: --name: it must have")
    ours.write_bytes(ours.read_bytes()[:-1])
    msb("report", ours, "-o", tmp_path / "x").ends(3, f"RECORD_INVALID: {ours}: ")
    assert not (tmp_path / "x").exists()


def test_photographs_that_differ_are_said(tmp_path: Path) -> None:
    files = []
    for name, key in (("one", "a" * 16), ("two", "b" * 16)):
        record = make_result(
            "mipnerf360", "garden", "two_dts", "dedicated", inputs={"quality": {"photographs": key}}
        )
        (tmp_path / f"{name}.zip").write_bytes(write_submission("Lab", [record], []))
        files.append(read_submission(tmp_path / f"{name}.zip"))
    (note,) = build_board(files).notes
    one, two = (f"Lab ({each.sha256[:6]})" for each in files)
    where = "Mip-NeRF 360, garden, 2DTS"
    assert note == f"not on the same photographs, size or background: {one} and {two}, of {where}"


def test_nobody_has_the_name_of_another_or_of_the_paper(tmp_path: Path) -> None:
    def sent(name: str, scene: str) -> Submission:
        (tmp_path / "a.zip").write_bytes(
            write_submission(name, [make_result("mipnerf360", scene, "two_dts", "dedicated")], [])
        )
        return read_submission(tmp_path / "a.zip")

    two = [sent("Lab", "garden"), sent("Lab", "room")]
    posing = [sent(f"Lab ({two[0].sha256[:6]})", "counter"), sent("The paper", "bonsai")]
    board = build_board([*two, *posing])
    names = [name for name, _ in board.submissions]
    assert names == [
        *(f"Lab ({each.sha256[:7]})" for each in two),
        posing[0].about.name,
        f"The paper ({posing[1].sha256[:7]})",
    ]
    assert {row["From"] for row in _rows(board)} == {*names, "the paper"}


@pytest.mark.parametrize(
    "name",
    [
        "The  paper",
        "the\u00a0paper",
        "the pa\u034fper",
        "the\u3164paper",
        "the paper\u2800",
        "\uff54he paper",
    ],
)
def test_what_looks_like_the_name_of_the_paper_has_a_hash(name: str) -> None:
    (shown,) = _names([_sent_by(name)])
    assert shown.endswith(" (000000)")


def test_names_that_look_the_same_are_told_apart() -> None:
    names = ["Lab X", "Lab  X", "lab x\u200b", "Lab Y", "\u3164"]
    shown = _names([_sent_by(name, str(number)) for number, name in enumerate(names)])
    assert shown == ["Lab X (000000)", "Lab  X (111111)", "lab x (222222)", "Lab Y", "4" * 12]


def _sent_by(name: str, digit: str = "0", records: tuple[Result, ...] = ()) -> Submission:
    about = About(name=name, tool_version="1", code_sha256="0" * 64, commands=(), files={}, pictures=())
    return Submission(Path("x.zip"), digit * 64, about, records, {})


@pytest.mark.parametrize("what", ["label", "dataset", "scene"])
def test_twice_the_records_are_twice_the_work(what: str) -> None:
    made = make_result("capture", "desk", "two_dts", "dedicated")

    def calls(count: int) -> int:
        cells = (made.cell.model_copy(update={what: f"n{number}"}) for number in range(count))
        sent = _sent_by("Lab", records=tuple(made.model_copy(update={"cell": cell}) for cell in cells))
        events: list[str] = []
        before = sys.getprofile()
        sys.setprofile(lambda _frame, event, _argument: events.append(event))
        try:
            build_board([sent])
        finally:
            sys.setprofile(before)
        return events.count("call")

    calls(1)  # what is read once
    assert calls(80) < 2.1 * calls(40)


def test_pictures_are_small(submission: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(submission)) as archive:
        names = [name for name in archive.namelist() if name.startswith("pictures/")]
        assert max(Image.open(io.BytesIO(archive.read(name))).width for name in names) <= 480
