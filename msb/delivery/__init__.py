"""Converts assets to files that other programs open without further settings."""

from typing import Literal

Engine = Literal["unreal", "unity", "godot", "blender", "three", "web"]
