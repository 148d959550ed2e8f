"""`msb capture`: a scene from photographs alone."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated, Literal

from msb.base.option import Argument, Option
from msb.base.paths import shell_word
from msb.cli.command import command, require
from msb.cli.output import JsonOutput, echo
from msb.errors import SceneError


@dataclass(frozen=True)
class CaptureOptions:
    """Options for the output and for the comparison of photographs."""

    out: Annotated[
        Path | None,
        Option("Write the scene to this folder.", ("--out", "-o"), metavar="SCENE", output="folder"),
    ] = None
    matching: Annotated[
        Literal["exhaustive", "sequential"],
        Option(
            "exhaustive: compare all pairs of photographs. sequential: compare neighbours by name, for video "
            "frames. The time of sequential grows linearly with the number of photographs, the time of "
            "exhaustive quadratically."
        ),
    ] = "exhaustive"
    seed: Annotated[int, Option("Set the seed of the random search.", least=0)] = 0


@command("msb capture photographs -o out/scene")
def capture(
    path: Annotated[Path, Argument("A folder of photographs.", metavar="PHOTOGRAPHS")],
    options: CaptureOptions,
    output: JsonOutput,
) -> None:
    """Find the poses of photographs, and write a scene that all commands can read.

    pycolmap finds camera poses, the lens and points (extra capture). The scene has undistorted, losslessly
    stored images and pinhole cameras, like scenes written by msb scenes --undistort. Take sharp photographs
    that overlap by two thirds and show nothing that moves. The recovered coordinates have no unit. Use
    --scale or --known-distance to set a unit.
    """
    require(options.out, "Missing output. Pass -o with the folder to write, for example -o scene")
    assert options.out is not None
    from msb.metrics.ground_truth import read_photograph, read_photograph_mask
    from msb.scenes.datasets.describe import describe_lens
    from msb.scenes.datasets.layout import images_in
    from msb.scenes.datasets.read import scene_of_cameras
    from msb.scenes.poses_from_images import find_poses
    from msb.scenes.write_capture import write_capture

    start = perf_counter()
    output.add_inputs([path])
    names = [image.name for image in images_in(path)]
    if len(names) < 3:
        text = f"the folder contains {len(names)} photographs; at least 3 are needed, and 20 to 100 are usual"
        raise SceneError("CAPTURE_FAILED", text, file=path)
    output.check_folder(options.out)
    with output.bars("steps") as progress:
        found = find_poses(path, names, options.matching, options.seed, progress)
    # Undistort the registered photographs.
    scene = scene_of_cameras(path, found.cameras)
    views = len(scene.train)
    with output.counted("undistorting", views) as step:
        write_capture(
            scene,
            options.out,
            found.points,
            read_photograph,
            read_photograph_mask,
            step,
            overwrite=output.force,
        )
    lens = describe_lens(found.cameras[0])
    output.write_json(
        {
            "schema": "msb.capture/1",
            "path": str(path),
            "output": str(options.out),
            "photographs": len(names),
            "registered": views,
            "reprojection_error": found.reprojection_error,
            "lens": lens,
            "points": len(found.points[0]),
            "models": found.models,
            "seconds": perf_counter() - start,
        }
    )
    for warning in scene.warnings:
        output.note(warning.to_line(warning.file or path))
    if views < len(names):
        lost = sorted(set(names) - {str(camera.name) for camera in found.cameras})
        more = ", ..." if len(lost) > 4 else ""
        output.note(
            f"{len(lost)} of {len(names)} photographs could not be placed: {', '.join(lost[:4])}{more}. They "
            f"are blurred or do not overlap with other photographs"
        )
    if len(found.models) > 1:
        others = " and ".join(map(str, found.models[1:3]))
        output.note(
            f"the photographs form {len(found.models)} groups that do not overlap. The largest group is "
            f"used; the others have {others} photographs. Add photographs between the groups"
        )
    if not output.prints_text:
        return
    values = ", ".join(f"{value:.6g}" for value in lens["parameters"])
    echo(
        f"{options.out}: {views} of {len(names)} photographs, {len(found.points[0]):,} points, mean "
        f"reprojection error {found.reprojection_error:.2f} pixels"
    )
    echo(f"lens {lens['model']} {values}, undistorted")
    if not output.quiet:
        echo(f"next: msb scenes {shell_word(options.out)}")
