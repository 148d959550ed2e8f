"""The tasks, a module each. A new one is a module here and a word in `msb.trial.registry`."""
