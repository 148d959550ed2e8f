"""Benchmarks need all capabilities and are skipped if one was removed."""

from tests.conftest import WHOLE

collect_ignore_glob = [] if WHOLE else ["test_*.py"]
