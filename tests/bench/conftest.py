"""Finished runs that tests share. A test that changes results uses a copy."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from msb.bench.protocol import ProtocolFile
from msb.bench.run import run_protocol
from tests.bench.protocols import make_protocol
from tests.cli.conftest import here, msb
from tests.metrics.conftest import vgg_file

__all__ = ["here", "msb", "vgg_file"]  # fixtures

REFERENCE = 'non_engine = "reference"'
VARIANT = '[[variants]]\nlabel = "engine"\norder = "global"\nsampling = "engine"'


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> ProtocolFile:
    """A finished run of two methods on one scene."""
    file = make_protocol(tmp_path_factory.mktemp("run"), keys=REFERENCE)
    assert run_protocol(file, jobs=2).exit_status == 0
    return file


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> ProtocolFile:
    """A finished run with a variant; interrupted runs and runs on a cluster must give equal results."""
    file = make_protocol(tmp_path_factory.mktemp("whole"), tail=VARIANT)
    assert run_protocol(file, jobs=2).exit_status == 0
    return file


@pytest.fixture
def again(finished: ProtocolFile, tmp_path: Path) -> ProtocolFile:
    """A copy of the finished run whose results a test may change."""
    shutil.copytree(finished.results, tmp_path / "results")
    return replace(finished, path=tmp_path / "protocol.toml")
