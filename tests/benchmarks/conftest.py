"""Benchmarks measure all capabilities together."""

from tests.conftest import WHOLE

collect_ignore_glob = [] if WHOLE else ["test_*.py"]
