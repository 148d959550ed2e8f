"""The file of an official checkpoint on somebody's machine: what it holds, what not, and how it goes on."""

import json
import platform
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import msb
from msb.base.children import Reply
from msb.errors import MsbError
from msb.render.images import to_bytes
from tests.conftest import ROOT
from tests.tiny import MODELS, SCENES

pytest.importorskip("msb.bench", reason="these benchmarks use msb.bench")
from benchmarks import official, official_stages
from benchmarks.official_stages import Given
from tests.bench.nvml import ME, nvml

KEPT = ROOT / "benchmarks" / "results" / "official-mesh_splatting-h200.json"
PRIVATE = "MySecret"


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the command about a checkpoint with official renderings and a capture, all of secret names.

    Stages run in this process, and no longer than they must.
    """

    def at_once(work: Any, word: str, *_: Any) -> Reply:
        return Reply(json.loads(json.dumps(work(word, {})[0], allow_nan=False)))

    monkeypatch.setattr(official, "run_apart", at_once)
    monkeypatch.setattr(official_stages, "_TIMED", 10)
    short = partial(official_stages.profile, seconds=0, warm_up=0)
    monkeypatch.setattr(official_stages, "profile", short)
    for name in ("standard/wgpu", "dedicated/wgpu"):
        monkeypatch.delitem(official_stages.STAGES, name)
    home = tmp_path / f"{PRIVATE}_home"
    model, capture = home / f"{PRIVATE}_model", home / f"{PRIVATE}_capture"
    shutil.copytree(MODELS / "pebble" / "two_dts", model)
    shutil.copytree(SCENES / "nerf_synthetic" / "pebble", capture)
    scene = Given(str(model), str(capture)).capture(msb.open(model))
    assert scene is not None
    place = model / "test" / "ours_30000" / "renders"
    place.mkdir(parents=True)
    for number, camera in enumerate(scene.test):
        image = msb.render(model, camera, "dedicated", scene.background).image
        Image.fromarray(to_bytes(image)).save(place / f"{number:05d}.png")
    return [str(model), "--scene", str(capture), "-o", str(home / "out.json")]


@pytest.mark.slow
def test_the_file_holds_what_was_measured_and_nothing_of_the_user(
    mine: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, out = Path(mine[0]), Path(mine[-1])
    monkeypatch.setattr(platform, "node", lambda: PRIVATE)
    for name in ("USER", "LOGNAME", "USERNAME"):  # which getpass.getuser asks
        monkeypatch.setenv(name, PRIVATE)
    assert official.main(mine) == 0
    printed = capsys.readouterr().out
    assert printed.index(official.HELD) < printed.index("export ")
    text = out.read_text()
    for word in (PRIVATE, str(ROOT), str(Path.home()), "r_0", "pebble"):
        assert word not in text
    stages = json.loads(text)["stages"]
    assert not [name for name, found in stages.items() if "failed" in found]
    # The renderings are our own, so they are as near to the photographs as what we draw.
    near = stages["dedicated"]["psnr"]
    assert near["photographs"] == stages["official"]["psnr"] > 15
    assert near["official"] == 100
    assert stages["standard"]["psnr"]["official"] < 30
    costs = [one["db"] for one in stages["why"]["costs"] if not one["equal"]]
    assert costs == sorted(costs)
    assert stages["bake"]["geometry"] == "kept"

    # What is done is not done again; what failed is, and its words, which name files, are not kept.
    did: list[str] = []
    own = official._stage
    monkeypatch.setattr(official, "_stage", lambda name, given: did.append(name) or own(name, given))
    del stages["audit"]
    out.write_text(json.dumps({**json.loads(text), "stages": stages | {"official": {"failed": "time"}}}))
    next((model / "test").rglob("*.png")).unlink()
    assert official.main(mine) == 0
    assert did == ["machine", "export", "capture", "audit", "official"]
    assert PRIVATE not in out.read_text()
    after = json.loads(out.read_text())["stages"]
    assert after == stages | {name: after[name] for name in ("audit", "export")} | {
        "official": {"failed": "METRIC_IMAGE_NAMES"}
    }

    # Another model's file is left as it is.
    shutil.copytree(MODELS / "pebble" / "triangle_splatting", model, dirs_exist_ok=True)
    shutil.rmtree(model / "ckpt")
    before = out.read_bytes()
    assert official.main(mine) == 2
    assert "another model" in capsys.readouterr().err
    assert out.read_bytes() == before


@pytest.mark.slow
def test_memory_of_a_graphics_card_that_is_pretended(
    mine: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = Given(mine[0], mine[2])
    monkeypatch.setitem(sys.modules, "pynvml", nvml({ME: 300}, 700))
    gpu = dict.fromkeys(official_stages._OF_DEVICE, "A GPU") | {"kind": "gpu"}
    monkeypatch.setattr(official_stages, "machine", lambda *_, **__: {"device": gpu})
    assert official_stages.stage_machine(given)["nvidia"] == [{"name": "A GPU", "total_bytes": 1000}]
    drawn = official_stages.stage_draw(given, "standard")
    assert drawn["device"] == gpu
    assert drawn["gpu_memory"] == {"bytes": 300, "source": "processes", "reason": None}


@pytest.mark.slow
def test_a_stage_runs_in_a_process_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    found = official._stage("export", Given(str(MODELS / "pebble" / "two_dts")))
    assert (found["method"], found["faces"]) == ("two_dts", 500)
    gone = official._stage("export", Given(str(ROOT / PRIVATE)))
    assert gone == {"failed": "FILE_NOT_FOUND"}
    assert PRIVATE in capsys.readouterr().out


def test_the_page_shows_what_is_held_and_the_tables_of_the_kept_file() -> None:
    page = (ROOT / "docs" / "official.md").read_text()
    assert official.HELD in page
    rows = official.tables([official.read(KEPT)]).splitlines()
    assert set(rows) <= set((ROOT / "benchmarks" / "pages" / "official.md").read_text().splitlines())


@pytest.mark.parametrize("wrong", [{"schema": "msb.bench/1"}, {"schema": official.SCHEMA, "stages": {}}])
def test_a_file_of_something_else_is_refused(
    wrong: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.json").write_text(json.dumps(wrong))
    assert official.main(["--table", str(tmp_path / "a.json")]) == 3
    assert "FILE_NOT_RECOGNISED" in capsys.readouterr().err
    with pytest.raises(MsbError, match="FILE_NOT_RECOGNISED"):
        official.tables([wrong])
