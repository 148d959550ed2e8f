"""What is said of bad assets, checkpoints, cameras and scenes: a code says what to do, this what is wrong.

They are kept in tests/golden/refusals.json, a line a file; `python -m tests.corpus.refusals` writes them anew
where a message was changed on purpose, and the difference is read like code.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from pathlib import Path

import msb
from msb.adapters.checkpoint import read_checkpoint
from msb.asset import validate
from msb.errors import CheckpointError, Finding, InputError, SceneError
from msb.scenes import read_scene
from tests.adapters import bad_checkpoints
from tests.corpus import bad_assets
from tests.scenes import bad_cameras
from tests.scenes.datasets import bad_scenes, conftest

KEPT = Path(__file__).parents[1] / "golden" / "refusals.json"
_FOREIGN = re.compile(r"(is not JSON|cannot be (?:read|opened|listed)|is not UTF-8): .*", re.DOTALL)
"""What follows is said by Python or the system, each version in its own words."""


def kept() -> dict[str, str]:
    """Return kind and name of a bad file -> what is said of it."""
    words: dict[str, str] = json.loads(KEPT.read_text(encoding="utf-8"))
    return words


def own_words(message: str) -> str:
    """Return a message without what others say in it."""
    return _FOREIGN.sub(r"\1", message)


def of_case(findings: list[Finding], code: str) -> str:
    """Return what the finding of a case says."""
    return own_words(next(item.message for item in findings if item.code == code))


def _write() -> None:
    words = {}
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        for case in bad_assets.CASES:
            path = bad_assets.write_case(case, root)
            try:
                found = (msb.validate if case.found_by == "command" else validate)(path)
                words[f"asset/{case.name}"] = of_case(list(found.findings), case.code)
            except InputError as error:
                words[f"asset/{case.name}"] = own_words(error.message)
            except StopIteration:  # permissions, which root need not have
                pass
        for case in bad_checkpoints.CASES:
            try:
                read_checkpoint(bad_checkpoints.write_case(case, root))
            except CheckpointError as error:
                words[f"checkpoint/{case.name}"] = own_words(error.message)
        for number, name in enumerate(bad_cameras.BAD):
            try:
                bad_cameras.read_case(name, root / str(number))
            except SceneError as error:
                words[f"cameras/{name}"] = own_words(error.message)
        for name, (place, change, *_) in bad_scenes.BAD.items():
            scene = shutil.copytree(conftest.STUBS / place, root / name / place)
            change(scene)
            try:
                read_scene(scene)
            except SceneError as error:
                words[f"scene/{name}"] = own_words(error.message)
    KEPT.write_text(json.dumps(words, indent=0, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    _write()
