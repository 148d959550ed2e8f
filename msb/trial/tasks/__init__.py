"""The tasks. Each module defines a tuple `TASKS`, and is listed in `msb.trial.registry`."""
