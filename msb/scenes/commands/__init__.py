"""The commands `msb scenes` and `msb capture`."""
