"""Public functions that `msb` exports: audit, open, validate and the demo data."""
