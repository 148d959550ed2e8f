"""The built-in methods, one folder each; `msb.registry` finds built-in and installed methods."""
