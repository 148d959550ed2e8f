"""The official glTF-Validator checks every GLB that tests write (see tests/conftest.py)."""

from pathlib import Path

import pytest

from tests.cli.conftest import Msb, msb
from tests.meshes.checks import make, written
from tests.validator import Validator, missing

__all__ = ["msb"]


@pytest.mark.slow
def test_the_validator_sees_written_files_and_finds_errors(
    validator: Validator | None, demo_asset: Path, msb: Msb, tmp_path: Path
) -> None:
    if validator is None:
        pytest.skip(str(missing()))
    good = written(make(float, "uint8 rgba"), ".glb")
    msb("convert", demo_asset, tmp_path / "a.glb")
    kept = {path.read_bytes() for path in validator.written.glob("*.glb")}
    assert kept == {good, (tmp_path / "a.glb").read_bytes()}
    assert validator.judge_written() == {}
    assert not list(validator.written.iterdir())
    (validator.written / "bad.glb").write_bytes(good.replace(b'"doubleSided":true', b'"doubleSided":1234'))
    assert "TYPE_MISMATCH" in validator.judge_written()["bad.glb"][0]
