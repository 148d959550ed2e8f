"""Coverage-guided fuzzing of every reader: ``python -m fuzz --help``. See CONTRIBUTING.md."""
