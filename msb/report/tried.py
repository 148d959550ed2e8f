"""The former names of `msb.report.mesh_trials`, used by fuzz.readers."""

from msb.report.mesh_trials import read_repairs as repairs
from msb.report.mesh_trials import read_task_outcomes as tried_tasks

__all__ = ["repairs", "tried_tasks"]
