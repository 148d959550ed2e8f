"""Coverage-guided fuzzing of every reader: ``python -m fuzz --help``. CONTRIBUTING.md says what was run."""
