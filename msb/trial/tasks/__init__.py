"""The tasks. Each module of this package defines a tuple `TASKS`, and is listed in `msb.trial.registry`."""
