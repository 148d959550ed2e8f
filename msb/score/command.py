"""`msb score`: how near an asset is to the photographs of the real thing."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msb.base.option import Argument
from msb.cli.command import command
from msb.cli.output import LinesOutput, Output, echo, report_error
from msb.errors import UsageError, about, one_line
from msb.render.options import RendererOptions, SceneOptions, parse_color_option
from msb.score.options import ScoreOptions, parse_condition

if TYPE_CHECKING:
    from msb.score import Comparison, Score
    from msb.score.capture import Capture

# File suffix -> programs that open such a file directly.
_OPENS = {
    ".glb": "web, Blender, Godot, Unreal",
    ".gltf": "web, Blender, Godot, Unreal",
    ".obj": "Blender, Unity, Godot, Unreal",
    ".usd": "Blender, Unreal, Omniverse",
    ".usda": "Blender, Unreal, Omniverse",
    ".usdc": "Blender, Unreal, Omniverse",
    ".usdz": "iOS, Blender, Unreal, Omniverse",
    ".ply": "Blender, MeshLab",
    ".stl": "Blender, slicers",
}


@command(
    "msb score --pose capture --capture data_stubs/scenes/mipnerf360/pebble \\\n"
    "      data_stubs/models/walled/mesh_splatting",
    "msb score --pose capture --capture data_stubs/scenes/nerf_synthetic/pebble \\\n"
    "      --walk 24 -o out/certificate data_stubs/models/pebble/two_dts",
)
def score(
    paths: Annotated[
        tuple[Path, ...],
        Argument("One asset, checkpoint or mesh file, or several to compare.", metavar="ASSET..."),
    ],
    options: ScoreOptions,
    reading: SceneOptions,
    drawing: Annotated[RendererOptions, ("device",)],
    output: LinesOutput,
) -> int:
    """State how near an asset is to the photographs of the real thing, with a certificate.

    The pose of the asset is found from the photographs. The asset is drawn unlit with 16 samples per pixel
    from the cameras of held-out photographs, and compared with them. The structure of its mesh is audited.
    An asset whose pose cannot be found is UNVERIFIED; it has no numbers, and the exit status is 1. Flags name
    what raises numbers without being the thing, such as photographs on cards. Several assets are compared
    view by view.
    """
    from msb.api.command_files import for_each
    from msb.base.extras import need_extra
    from msb.score import compare_scores
    from msb.score import score as measure
    from msb.score.capture import Capture as ReadCapture
    from msb.score.capture import Protocol
    from msb.score.certificate import write_certificate
    from msb.score.measurement import SCHEMA

    if options.capture is None:
        raise UsageError(
            "USAGE", "Missing photographs. Pass --capture with a scene, for example --capture scene"
        )
    if 0 < options.walk < 3:
        raise UsageError("USAGE", f"--walk is {options.walk}; a walk needs at least 3 frames")
    if options.trial:
        if find_spec("msb.trial") is None:
            raise UsageError(
                "EXTRA_MISSING", "--trial needs msb.trial, which is not part of this installation"
            )
        from msb.trial.registry import check_libraries, select_tasks

        check_libraries(select_tasks(options.trial))
    conditions = [parse_condition(text) for text in options.fail_on]
    if options.out is not None:
        output.check_folder(options.out)
    need_extra("capture", "cv2", what="msb score")
    drawing.check_device()
    output.add_input(options.capture)
    protocol = Protocol(options.supersample, parse_color_option(options.background))
    capture = ReadCapture(options.capture, protocol, **reading.given)
    for warning in capture.scene.warnings:
        output.note(warning.to_line(warning.file or options.capture))
    # The features of the photographs are found once for all assets.
    scores: list[Score] = []
    comparisons: list[Comparison] = []

    def work(path: Path, _alone: bool) -> tuple[dict[str, Any], int]:
        """Score one asset, and compare it with the first."""
        with output.progress(f"scoring {path.name}"), about(path):
            entry = measure(
                path,
                capture,
                pose=options.pose,
                walk=options.walk,
                vgg_weights=options.vgg_weights,
                device=drawing.device,
            )
        document = entry.to_dict()
        if options.trial:
            document["trial"] = _try_tasks(path, options.trial, drawing.device)
        scores.append(entry)
        if output.prints_text:
            _print_score(entry, capture, output)
            for tried in document["trial"] or ():
                echo(one_line(f"{'':<10} {tried['task']}: {tried['outcome']}; {tried['why'] or ''}"))
        if len(scores) > 1:
            comparisons.append(compare_scores(scores[0], entry))
            document["compared"] = comparisons[-1].to_dict()
            if output.prints_text:
                _print_comparison(comparisons[-1])
        if entry.status == "unverified":
            return document, 1
        errors = [error for condition in conditions if (error := condition.check(document)) is not None]
        return document, max([0, *map(report_error, errors)])

    status, documents = for_each(paths, SCHEMA, output, work)
    if options.out is not None and scores:
        write_certificate(options.out, scores, comparisons, documents, overwrite=output.force)
        if output.prints_text:
            echo(f"certificate: {one_line(str(options.out / 'index.html'))}")
    return status


def _try_tasks(path: Path, tasks: tuple[str, ...], device: str | None) -> list[dict[str, Any]]:
    """Return the outcomes of tasks on an asset."""
    from msb.api.opening import open
    from msb.trial.run import try_asset

    tried = try_asset(open(path), tasks, device=device).trials
    return [{"task": trial.task, "outcome": trial.outcome, "why": trial.why} for trial in tried]


def _print_score(entry: Score, capture: Capture, output: Output) -> None:
    """Print a score in a few lines."""
    scene = capture.scene
    held = f"{len(scene.train) + len(scene.test)} photographs, {len(scene.test)} held out"
    echo(one_line(f"{entry.path} against {scene.name} ({held})"))
    if output.quiet:
        echo(one_line(entry.verdict))
        return
    looks, *more = _describe_looks(entry)
    rows = [("looks", looks), *(("", line) for line in more), ("structure", _describe_structure(entry))]
    for label, text in (*rows, ("pose", _describe_pose(entry)), ("verdict", entry.verdict)):
        echo(one_line(f"{label:<10} {text}"))


def _print_comparison(comparison: Comparison) -> None:
    """Print the differences of an asset from the first."""
    echo(one_line(f"{comparison.second} minus {comparison.first}, 95 % intervals over paired views"))
    for name, text in _describe_differences(comparison):
        echo(f"{name:<21} {text}")


def _describe_looks(entry: Score) -> Iterator[str]:
    """Yield the lines about pictures."""
    looks = entry.looks
    if looks is None or entry.covered_share is None:
        yield "no number, because the asset is unverified"
        return
    lpips = "--" if looks["lpips"] is None else f"{looks['lpips']:.3f}"
    line = f"PSNR {_decibels(looks['psnr'])}   SSIM {looks['ssim'] or 0:.3f}   LPIPS {lpips}"
    line += f"   ({100 * entry.covered_share:.0f} % of the pixels covered)"
    if entry.steadiness is not None:
        line += f"   shimmer {entry.steadiness.shimmer:.1f} of 255"
        line += f", {100 * entry.steadiness.popping:.2f} % of the pixels pop"
    yield line
    line = f"PSNR {_decibels(looks['psnr_covered'])} where covered"
    if looks["psnr_mask"] is not None:
        line += f", {_decibels(looks['psnr_mask'])} inside the masks"
    yield f"{line}, {_decibels(looks['psnr_exposure'])} after exposure correction"


def _decibels(value: float | None) -> str:
    return "--" if value is None else f"{value:.1f} dB"


def _describe_structure(entry: Score) -> str:
    """Return the line about the file."""
    mesh = entry.structure
    sizes = " and ".join(f"{width} x {height}" for width, height in mesh.textures[:3])
    textures = f"{len(mesh.textures)} textures of {sizes}" if mesh.textures else "no texture"
    textures = textures.replace("1 textures", "1 texture")
    opens = _OPENS.get(Path(entry.path).suffix.lower())
    text = f"{mesh.verdict.upper()}: {mesh.faces:,} faces, {entry.audit.judged.counts.components:,} pieces"
    text += f"   file {mesh.bytes / 1e6:.1f} MB, {textures}"
    return text if opens is None else f"{text}, opens in: {opens}"


def _describe_pose(entry: Score) -> str:
    """Return the line about the pose."""
    pose = entry.pose
    if pose is None:
        return f"not found: {entry.why}"
    if pose.source != "found":
        return "that of the capture" if pose.source == "capture" else f"from a file, scale {pose.scale:.4g}"
    mirrored = ", mirrored" if pose.mirrored else ""
    return (
        f"found from {pose.photographs} photographs, residual {pose.residual:.1f} px, "
        f"scale {pose.scale:.4g} (unit unknown){mirrored}"
    )


def _describe_differences(comparison: Comparison) -> Iterator[tuple[str, str]]:
    """Yield a row for each metric: its name, and the mean difference with its interval."""
    if not comparison.differences:
        yield "none", "an asset is unverified"
    for name, entry in comparison.differences.items():
        ends = entry["interval"]
        around = "" if ends is None else f" ({ends[0]:+.3f} to {ends[1]:+.3f})"
        yield name.replace("psnr_both", "psnr where both cover"), f"{entry['mean']:+.3f}{around}"
