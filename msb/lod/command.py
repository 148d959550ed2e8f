"""`msb lod`: levels of detail, collision and names for a mesh that keeps its texture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msb.base.option import Option
from msb.cli.command import command, require
from msb.cli.output import JsonOutput, echo, is_stdout
from msb.errors import UsageError
from msb.lod.options import LodOptions
from msb.render.options import RendererOptions, Source


@dataclass(frozen=True)
class LodFiles:
    """The output."""

    out: Annotated[
        Path | None,
        Option(
            "Write to OUT: a .glb or another mesh format; for mujoco and isaac a folder.",
            ("--out", "-o"),
            metavar="OUT",
            output="own",
        ),
    ] = None
    name: Annotated[
        str | None, Option("Name of the asset in the files. Default: the name of OUT.", metavar="NAME")
    ] = None


@command(
    "msb lod data_stubs/checkpoint -o out/plate.glb --collision box",
    "msb lod --lods 20000,5000 --one-file chair.glb -o out/chair.glb",
    "msb lod --for isaac --mass 4 --label chair chair.glb -o out/chair",
)
def lod(
    path: Source,
    files: LodFiles,
    options: LodOptions,
    drawing: Annotated[RendererOptions, ("device",)],
    output: JsonOutput,
) -> None:
    """Make levels of detail and a collision shape for a mesh, which keeps its texture.

    A GLB keeps its textures, texture coordinates, normals, tangents, materials, nodes, skins, animations,
    extras and names. Textures of levels shrink with the number of faces. Levels and the collision shape are
    written next to OUT: NAME_lod1, NAME_collision.

    A level is usable if its images have at least 35 dB (from half of the faces up), 30 dB (from a quarter up)
    or 25 dB to the whole asset, in 8 views around it. Other levels are reported, and only written with
    --force.
    """
    place = files.out
    require(place, "Missing output. Pass -o with the file to write, for example -o chair.glb")
    assert place is not None
    from msb.delivery.saving import output_suffix
    from msb.lod import lod as run_lod
    from msb.lod.run import add_ending

    # Check all outputs before the work.
    if options.is_folder:
        output.check_folder(place)
    else:
        if is_stdout(place) or output_suffix(place, "OUT") == ".triasset":
            raise UsageError("USAGE", "OUT must be a mesh file, such as chair.glb", file=place)
        endings = ["", "_collision", *(f"_lod{n}" for n in range(1, len(options.wanted) + 1))]
        for ending in endings:
            output.check_free(add_ending(place, ending), label="--out")
    with output.bars("steps") as progress:
        lods = run_lod(
            path,
            name=files.name or place.stem,
            device=drawing.device,
            progress=progress,
            **vars(options),
        )
    report = lods.save(place, overwrite=output.force, unusable=output.force)
    output.write_json({"path": str(path), **report.to_dict()})
    if output.prints_text:
        for line in report.describe(is_brief=output.quiet):
            echo(line)
    for text in report.notes:
        output.note(text)
