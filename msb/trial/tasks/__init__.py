"""The tasks. Each module has a tuple `TASKS`, and a line in `msb.trial.registry`."""
