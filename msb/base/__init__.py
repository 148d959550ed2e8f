"""Helpers that know nothing of meshes: atomic writes, opening files, child processes, extras."""
