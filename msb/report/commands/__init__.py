"""The commands `msb report`, `msb submit` and `msb methods`."""
