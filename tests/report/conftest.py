"""Synthetic results of a complete benchmark, written once per session."""

from pathlib import Path

import pytest

from msb.report.build import build_report
from msb.report.numbers import Numbers
from msb.report.report import Report
from msb.report.results import read_results
from tests.cli.conftest import here, msb
from tests.report.factory import write_results

__all__ = ["here", "msb"]  # fixtures


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a results folder with all datasets, scenes, methods and conditions."""
    return write_results(tmp_path_factory.mktemp("results"))


@pytest.fixture(scope="session")
def whole(results: Path) -> Report:
    """Return the report on all results, without charts and renderings."""
    return build_report(read_results(results), pictures=False)


@pytest.fixture(scope="session")
def numbers(whole: Report) -> Numbers:
    """Return the numbers of all results."""
    return whole.numbers


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a results folder of one dataset with two scenes, with images."""
    return write_results(tmp_path_factory.mktemp("small"), datasets=["tanksandtemples"], images=True)


@pytest.fixture(scope="session")
def report(small: Path) -> Report:
    """Return the report on the two scenes."""
    return build_report(read_results(small))
