"""Every bad checkpoint, mesh, source of cameras and scene gives its code, in one clear line."""

from pathlib import Path

import pytest

from msb.errors import CheckpointError, MeshFileError, MsbError, SceneError
from tests.adapters.bad_checkpoints import CASES as CHECKPOINTS
from tests.corpus.refusals import REFUSED, kept, own_words


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_file_gives_its_code(name: str, tmp_path: Path) -> None:
    code, read = REFUSED[name]
    with pytest.raises(MsbError) as caught:
        read(tmp_path)
    error = caught.value
    assert error.code == code
    assert own_words(error.message.replace(str(tmp_path), "")) == kept()[name]
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
    # The other codes of checkpoints are about models (test_bad_models.py), those of scenes about arguments.
    assert {case.code for case in CHECKPOINTS} <= CheckpointError.codes
    assert codes_of("checkpoint") == {
        f"CHECKPOINT_{what}" for what in ("NOT_RECOGNISED", "DAMAGED", "HOSTILE", "FORM")
    }
    assert codes_of("mesh") == MeshFileError.codes - {"MESH_FILE_LEFT_OUT"}  # a note
    cameras = {code for code in SceneError.codes if not code.startswith("SCENE_")}
    assert codes_of("cameras") == cameras - {"CAMERA_PATH"}
    about_files = {"SCENE_LAYOUT", "SCENE_IMAGE", "SCENE_IMAGE_MISSING"}
    assert codes_of("scene") & SceneError.codes >= about_files
