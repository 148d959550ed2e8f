"""Bad contents of files give their error codes."""

import time
from pathlib import Path

import pytest

from fuzz.targets import TARGETS
from tests.fuzz.bad_binaries import BAD as BAD_BINARIES
from tests.fuzz.bad_texts import BAD as BAD_TEXTS

SECONDS = 2.0
"""Limit of processor time per file."""
BAD = BAD_TEXTS | BAD_BINARIES


@pytest.mark.parametrize("name", BAD)
def test_bad_content(name: str, tmp_path: Path) -> None:
    target, content, code = BAD[name]
    feed = TARGETS[target].at(tmp_path)
    start = time.process_time()
    error = feed(content)
    assert time.process_time() - start < SECONDS
    assert error.code == code
