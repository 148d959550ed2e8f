"""The built-in methods. Each method has a folder. `msb.registry` finds built-in and installed methods."""
