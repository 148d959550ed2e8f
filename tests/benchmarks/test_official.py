"""`benchmarks.official`: the file of measurements of an official checkpoint on a user's machine."""

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
    """Return the arguments for a checkpoint with official renderings and a capture, all with private names.

    Stages run in this process with the shortest timings.
    """

    def run_here(work: Any, word: str, *_: Any) -> Reply:
        return Reply(json.loads(json.dumps(work(word, {})[0], allow_nan=False)))

    monkeypatch.setattr(official, "run_in_child", run_here)
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
def test_the_file_has_the_measurements_and_nothing_private(
    mine: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, out = Path(mine[0]), Path(mine[-1])
    monkeypatch.setattr(platform, "node", lambda: PRIVATE)
    for name in ("USER", "LOGNAME", "USERNAME"):  # read by getpass.getuser
        monkeypatch.setenv(name, PRIVATE)
    assert official.main(mine) == 0
    printed = capsys.readouterr().out
    assert printed.index(official.HELD) < printed.index("export ")
    text = out.read_text()
    for word in (PRIVATE, str(ROOT), str(Path.home()), "r_0", "pebble"):
        assert word not in text
    stages = json.loads(text)["stages"]
    assert not [name for name, found in stages.items() if "failed" in found]
    # The official renderings are images of our renderer, so both have the same PSNR to the photographs.
    psnr = stages["dedicated"]["psnr"]
    assert psnr["photographs"] == stages["official"]["psnr"] > 15
    assert psnr["official"] == 100
    assert stages["standard"]["psnr"]["official"] < 30
    costs = [cost["db"] for cost in stages["why"]["costs"] if not cost["equal"]]
    assert costs == sorted(costs)
    assert stages["bake"]["geometry"] == "kept"

    # Finished stages are kept and failed ones are repeated. Error messages name files and are not stored.
    did: list[str] = []
    run_stage = official._stage
    monkeypatch.setattr(official, "_stage", lambda name, given: did.append(name) or run_stage(name, given))
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

    # The file of another model is not changed.
    shutil.copytree(MODELS / "pebble" / "triangle_splatting", model, dirs_exist_ok=True)
    shutil.rmtree(model / "ckpt")
    before = out.read_bytes()
    assert official.main(mine) == 2
    assert "another model" in capsys.readouterr().err
    assert out.read_bytes() == before


@pytest.mark.slow
def test_gpu_memory_with_a_fake_driver(mine: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    given = Given(mine[0], mine[2])
    monkeypatch.setitem(sys.modules, "pynvml", nvml({ME: 300}, 700))
    gpu = dict.fromkeys(official_stages._OF_DEVICE, "A GPU") | {"kind": "gpu"}
    monkeypatch.setattr(official_stages, "machine", lambda *_, **__: {"device": gpu})
    assert official_stages.stage_machine(given)["nvidia"] == [{"name": "A GPU", "total_bytes": 1000}]
    drawn = official_stages.stage_draw(given, "standard")
    assert drawn["device"] == gpu
    assert drawn["gpu_memory"] == {"bytes": 300, "source": "processes", "reason": None}


@pytest.mark.slow
def test_a_stage_runs_in_its_own_process(capsys: pytest.CaptureFixture[str]) -> None:
    stage = official._stage("export", Given(str(MODELS / "pebble" / "two_dts")))
    assert (stage["method"], stage["faces"]) == ("two_dts", 500)
    missing = official._stage("export", Given(str(ROOT / PRIVATE)))
    assert missing == {"failed": "FILE_NOT_FOUND"}
    assert PRIVATE in capsys.readouterr().out


def test_the_page_lists_the_contents_of_the_stored_file() -> None:
    page = (ROOT / "docs" / "official.md").read_text()
    assert official.HELD in page
    rows = official.tables([official.read(KEPT)]).splitlines()
    assert set(rows) <= set((ROOT / "benchmarks" / "pages" / "official.md").read_text().splitlines())


@pytest.mark.parametrize("wrong", [{"schema": "msb.bench/1"}, {"schema": official.SCHEMA, "stages": {}}])
def test_other_files_are_rejected(
    wrong: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.json").write_text(json.dumps(wrong))
    assert official.main(["--table", str(tmp_path / "a.json")]) == 3
    assert "FILE_NOT_RECOGNISED" in capsys.readouterr().err
    with pytest.raises(MsbError, match="FILE_NOT_RECOGNISED"):
        official.tables([wrong])
