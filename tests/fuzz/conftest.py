"""Fuzz targets need all capabilities. If a capability was removed, no test of this folder is collected."""

from tests.conftest import WHOLE

collect_ignore_glob = [] if WHOLE else ["test_*.py"]
