"""Every bad checkpoint, mesh, camera file and scene gives its error code, with a message of one line."""

from pathlib import Path

import pytest

from msb.errors import CheckpointError, MeshFileError, MsbError, SceneError
from tests.adapters.bad_checkpoints import CASES as CHECKPOINTS
from tests.corpus.refusals import REFUSED, read_messages, without_foreign_text


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_file_gives_its_code(name: str, tmp_path: Path) -> None:
    code, read = REFUSED[name]
    with pytest.raises(MsbError) as caught:
        read(tmp_path)
    error = caught.value
    assert error.code == code
    assert without_foreign_text(error.message.replace(str(tmp_path), "")) == read_messages()[name]
    assert str(error.file).startswith(str(tmp_path))
    assert str(error) == f"{code}: {error.file}: {error.message}"
    assert str(error).isprintable()
    assert (error.pointer or "").isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None
    assert error.exit_status == 3


def codes_of(kind: str) -> set[str]:
    return {code for name, (code, _) in REFUSED.items() if name.startswith(f"{kind}/")}


def test_every_code_has_a_bad_file() -> None:
    # test_bad_models.py tests the other codes of checkpoints. The other codes of scenes are about arguments.
    assert {case.code for case in CHECKPOINTS} <= CheckpointError.codes
    assert codes_of("checkpoint") == {
        f"CHECKPOINT_{what}" for what in ("NOT_RECOGNISED", "DAMAGED", "HOSTILE", "FORM")
    }
    assert codes_of("mesh") == MeshFileError.codes - {"MESH_FILE_LEFT_OUT"}  # a note
    cameras = {code for code in SceneError.codes if not code.startswith("SCENE_")}
    assert codes_of("cameras") == cameras - {"CAMERA_PATH", "CAPTURE_FAILED"}
    codes_of_files = {"SCENE_LAYOUT", "SCENE_IMAGE", "SCENE_IMAGE_MISSING"}
    assert codes_of("scene") & SceneError.codes >= codes_of_files
