"""Targets of fuzzing read files of all capabilities."""

from tests.conftest import WHOLE

collect_ignore_glob = [] if WHOLE else ["test_*.py"]
