"""The commands `msb render` and `msb devices`."""
