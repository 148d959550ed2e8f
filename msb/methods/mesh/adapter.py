"""Read mesh files of the method "mesh", and meshes from the exporters of other methods."""

from dataclasses import dataclass, replace

from msb.adapters.locate import PRIMITIVE_PROPERTIES, Place, is_named
from msb.adapters.model import Content, Model, Options, Settings, background_of
from msb.adapters.training_config import read_cfg_args, trained_up, training_of
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.errors import about
from msb.meshes.assets import make_mesh_buffers
from msb.meshes.files import read_mesh
from msb.meshes.gltf import uses_gaussians
from msb.meshes.mesh import report_left_out, report_origin
from msb.registry import METHODS


def recognises(content: Content) -> bool:
    """Return whether `content` is a mesh file, and not a PLY with a table of primitives."""
    if content.place.kind == "ply":
        return not PRIMITIVE_PROPERTIES & set(content.ply_names)
    return content.place.kind == "mesh" and not uses_gaussians(content.place.file)


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the mesh at `place` with all rows and its colours as stored."""
    Settings("mesh", options.settings)  # the method "mesh" has no settings, so this call rejects every name
    mesh = read_mesh(place.file)
    with about(place.file):
        made = make_mesh_buffers(mesh)
    frame = CoordinateFrame(up=mesh.up or "unknown")
    description = Description(
        appearance=made.appearance, coordinate_frame=frame, origin=made.origin, frame=mesh.frame
    )
    notes = (*report_left_out(mesh), *report_origin(mesh))
    return Model(made.buffers, made.domains, description, place.root, (place.file,), notes)


@dataclass(frozen=True)
class ByName:
    """The adapter of a method that has no module `adapter`.

    This adapter reads mesh files with the file names of the method.
    """

    method: str

    def recognises(self, content: Content) -> bool:
        """Return whether `content` is a mesh file with a file name of this method."""
        return recognises(content) and is_named(METHODS[self.method], content.place.file)

    def read(self, place: Place, content: Content, options: Options) -> Model:
        """Return the mesh at `place`, with the values in its `cfg_args` file if that file exists."""
        model = read(place, content, options)
        description = replace(model.description, method=self.method)
        arguments, files, warnings = read_cfg_args(place.root)
        if not files:
            return replace(model, description=description)
        description = replace(
            description,
            appearance={**description.appearance, **background_of(arguments.get("white_background"))},
            training=training_of(arguments),
            coordinate_frame=CoordinateFrame(up=trained_up(arguments)),
        )
        return replace(
            model,
            description=description,
            files=(*model.files, *files),
            warnings=(*model.warnings, *warnings),
        )
