"""From an asset to files that programs open as they come."""

from typing import Literal

Engine = Literal["unreal", "unity", "godot", "blender", "three", "web"]
