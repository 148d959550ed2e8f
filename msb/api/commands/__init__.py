"""The commands that look at a file and tell what it holds."""
