"""The commands `msb view` and `msb compare`."""
