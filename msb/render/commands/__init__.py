"""The commands that draw, and that list what can draw."""
