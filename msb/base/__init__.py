"""Helpers that do not depend on meshes: atomic writes, opening files, child processes, optional packages."""
