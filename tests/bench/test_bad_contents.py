"""Bad protocols and records give their code."""

from pathlib import Path

import pytest

from fuzz.targets import TARGETS
from tests.bench.bad_texts import BAD


@pytest.mark.parametrize("name", BAD)
def test_bad_content(name: str, tmp_path: Path) -> None:
    target, content, code = BAD[name]
    assert TARGETS[target].at(tmp_path)(content).code == code
