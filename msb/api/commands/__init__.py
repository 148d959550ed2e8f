"""The commands `msb audit`, `msb info`, `msb validate` and `msb demo-data`."""
