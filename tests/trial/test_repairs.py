"""The comparison of repairs: what each makes is looked at and tried once."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset, build_asset
from msb.errors import DeviceError
from msb.repair.plan import Options
from msb.scenes import Camera
from msb.trial import repairs as module
from msb.trial.repairs import STORED, compare
from tests.conftest import BOOK, TETRAHEDRON


def test_every_row_has_the_trials_before_and_after_and_equal_results_are_tried_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[int] = []

    def try_asset(asset: Asset, tasks: tuple[str, ...], **_: Any) -> Any:
        asked.append(asset.manifest.vertex_count)
        outcome = "fails" if len(asked) == 1 else "care"
        trial = SimpleNamespace(task=tasks[0], outcome=outcome)
        return SimpleNamespace(trials=(trial,))

    monkeypatch.setattr(module, "try_asset", try_asset)
    ways = {"orient,cut": (("orient", "cut"), None), "cut": (("cut",), None), "weld": (("weld",), None)}
    monkeypatch.setattr(module, "STRATEGIES", ways)
    points, faces = BOOK
    asset = build_asset({"positions": points, "indices": faces.astype(np.uint32)}, {})
    camera = Camera.look_at((2, 3, -4), (0, 0, 0), up=(0, 1, 0), width=32, height=24, fov_y=0.8)
    rows = {row.strategy: row for row in compare(asset, [camera], Options(("weld",)), tasks=("solid",))}
    assert asked == [5, 9]
    assert rows[STORED].to_dict()["trials"] == rows["weld"].to_dict()["trials"] == {"solid": "fails"}
    after = rows["cut"].to_dict()
    assert (after["trials_passed_before"], after["trials_passed_after"]) == (0, 1)
    assert after["looks"]["standard"] == {"psnr": None, "same": True, "why": None}


def test_repairs_are_compared_without_a_device_and_without_pictures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def no_device(*_: object, **__: object) -> None:
        raise DeviceError("DEVICE_NOT_FOUND", "there is none")

    for place in ("msb.views", "msb.trial.repairs", "msb.repair.pictures"):
        monkeypatch.setattr(f"{place}.Renderer", no_device)
    monkeypatch.setattr(module, "STRATEGIES", {"orient": (("orient",), None)})
    asset = build_asset({"positions": TETRAHEDRON[0], "indices": TETRAHEDRON[1].astype(np.uint32)}, {})
    camera = Camera.look_at((2, 3, -4), (0, 0, 0), up=(0, 1, 0), width=32, height=24, fov_y=0.8)
    rows = compare(asset, [camera], Options(("orient",)), tasks=(), keep=tmp_path)
    assert [(row.strategy, row.picture, row.why) for row in rows] == [
        (STORED, None, None),
        ("orient", None, None),
    ]
    assert rows[1].looks is not None
    assert rows[1].looks["standard"].why.startswith("DEVICE_NOT_FOUND")
