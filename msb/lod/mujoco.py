"""The folder for MuJoCo: an MJCF model of one free body, its meshes and textures, and a floor."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from msb.meshes.assets import fit_to_format, with_faces
from msb.meshes.colors import as_floats
from msb.meshes.files import write_mesh
from msb.meshes.formats import Style
from msb.meshes.image_files import encode_image
from msb.meshes.mesh import Mesh

if TYPE_CHECKING:
    from msb.lod.packages import Body

_SCENE = """<mujoco model={scene}>
  <include file={file}/>
  <visual><headlight diffuse="0.6 0.6 0.6" ambient="0.3 0.3 0.3"/></visual>
  <worldbody>
    <light pos="0 0 {high:g}" dir="0 0 -1" directional="true"/>
    <geom name="floor" type="plane" size="0 0 {grid:g}"/>
  </worldbody>
</mujoco>
"""


def list_mujoco_files(body: Body) -> dict[str, bytes]:
    """Return the files of the folder; the first one is the model.

    Each texture has its own visible mesh, because an MJCF mesh has one material. Visible meshes do not
    collide. The inertia is that of the collision shape.
    """
    assets, geoms = [], []
    files: dict[str, bytes] = {}
    for number, (mesh, texture) in enumerate(_split_by_texture(body.mesh)):
        name = f"{body.name}_{number}"
        files[f"{name}.obj"] = _encode(mesh)
        material = f"<material name={quoteattr(name)} rgba={quoteattr(_mean_color(mesh))}"
        if texture is not None:
            files[f"{name}.png"] = encode_image(body.mesh.textures[texture], "png", body.mesh.sampler)[0]
            assets.append(f'<texture name={quoteattr(name)} type="2d" file={quoteattr(name + ".png")}/>')
            material += f" texture={quoteattr(name)}"
        assets.append(f"{material}/>")
        # The inertia of a visible mesh is not used; "shell" also suits open meshes.
        assets.append(f'<mesh name={quoteattr(name)} file={quoteattr(name + ".obj")} inertia="shell"/>')
        geoms.append(
            f'<geom type="mesh" mesh={quoteattr(name)} material={quoteattr(name)} group="2" contype="0" '
            'conaffinity="0" mass="0"/>'
        )
    for number, part in enumerate(body.parts):
        name = f"{body.name}_collision_{number:02d}"
        files[f"{name}.obj"] = _encode(part)
        assets.append(f"<mesh name={quoteattr(name)} file={quoteattr(name + '.obj')}/>")
        geoms.append(f'<geom type="mesh" mesh={quoteattr(name)} group="3" mass="0"/>')
    # The body begins on the floor.
    points = np.concatenate([part.vertices for part in body.parts])
    low, size = float(points[:, 2].min()), float(np.linalg.norm(np.ptp(points, axis=0)))
    i = body.inertia
    inertia = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    model = "\n".join(
        [
            f"<mujoco model={quoteattr(body.name)}>",
            "  <asset>",
            *(f"    {line}" for line in assets),
            "  </asset>",
            "  <worldbody>",
            f'    <body name={quoteattr(body.name)} pos="0 0 {-low:.9g}">',
            "      <freejoint/>",
            f'      <inertial pos="{_join(body.center)}" mass="{body.mass:.9g}" '
            f'fullinertia="{_join(inertia)}"/>',
            *(f"      {line}" for line in geoms),
            "    </body>",
            "  </worldbody>",
            "</mujoco>\n",
        ]
    )
    file = f"{body.name}.xml"
    scene = _SCENE.format(
        scene=quoteattr(f"{body.name} scene"), file=quoteattr(file), high=3 * size, grid=size / 10
    )
    return {file: model.encode(), "scene.xml": scene.encode(), **files}


def _join(values: object) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(np.asarray(values, float)))


def _encode(mesh: Mesh) -> bytes:
    """Return a mesh as OBJ without materials."""
    file = io.BytesIO()
    write_mesh(fit_to_format(mesh, ".obj"), file, suffix=".obj", style=Style())
    return file.getvalue()


def _split_by_texture(mesh: Mesh) -> list[tuple[Mesh, int | None]]:
    """Return the faces of each texture as a mesh, and its number."""
    if not mesh.textures:
        return [(mesh, None)]
    if mesh.face_textures is None:
        return [(mesh, 0)]
    used = np.unique(mesh.face_textures)
    return [(with_faces(mesh, mesh.face_textures == number), int(number)) for number in used]


def _mean_color(mesh: Mesh) -> str:
    """Return the average vertex colour as "r g b 1"."""
    if mesh.vertex_colors is None:
        return "1 1 1 1"
    return _join([*as_floats(mesh.vertex_colors)[:, :3].mean(axis=0), 1])
