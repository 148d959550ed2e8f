"""Names of nodes, meshes, materials and images, and of the parts of collision shapes for each program."""

from __future__ import annotations

from typing import Any

from msb.lod.options import Target


def set_names(root: dict[str, Any], name: str, ending: str = "") -> None:
    """Name everything in the JSON of a glTF file that has no name, after the asset.

    With an ending such as "_LOD1", nodes with meshes and meshes get it, also if they have names.
    """
    for key in ("meshes", "materials", "images"):
        entries = root.get(key, [])
        for number, entry in enumerate(entries):
            if not entry.get("name"):
                entry["name"] = name if len(entries) == 1 else f"{name}_{number}"
    nodes = root.get("nodes", [])
    for number, node in enumerate(nodes):
        if not node.get("name"):
            is_only = len(nodes) == 1
            named = root["meshes"][node["mesh"]]["name"] if "mesh" in node else f"{name}_node_{number}"
            node["name"] = name if is_only else named
    for entry in [*root.get("meshes", []), *(node for node in nodes if "mesh" in node)] if ending else []:
        entry["name"] += ending


def name_parts(name: str, count: int, kind: str, target: Target | None) -> list[str]:
    """Return the names of the parts of a collision shape, by which a program recognises them on import.

    Unreal reads convex parts named UCX_NAME_00. Godot makes a static body without an image of nodes whose
    names end with -convcolonly, or with -colonly for a shape that is not convex. Other programs get
    NAME_collision, numbered if there are several.
    """
    plain = [f"{name}_collision{f'_{number:02d}' if count > 1 else ''}" for number in range(count)]
    if target == "unreal":
        return [f"UCX_{name}_{number:02d}" for number in range(count)]
    if target == "godot":
        return [f"{word}{'-colonly' if kind == 'mesh' else '-convcolonly'}" for word in plain]
    return plain
