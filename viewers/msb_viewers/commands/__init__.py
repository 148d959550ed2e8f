"""The commands that show a mesh or compare the looks of a model."""
