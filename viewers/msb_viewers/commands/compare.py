"""`msb compare`: compare the renderer tiers of a model with its photographs, on a page or in an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import PlainOutput, echo
from msb.render.options import (
    NO_CAMERAS,
    NO_SCENE,
    ONLY_GENERATED,
    SCENE_OPTIONS,
    RendererOptions,
    SceneOptions,
    Source,
    ViewOptions,
    check_factor,
)
from msb_viewers.commands.window import Window


@dataclass(frozen=True)
class CompareOptions:
    """The renderer tiers and photographs to compare, and the first layout of the page."""

    scene: Annotated[
        Path | None,
        Option(
            "Show the test views of a dataset's scene. Image size, photographs and background are as in "
            "msb run. --camera train or all selects other views.",
            metavar="DIR",
        ),
    ] = None
    image_folder: Annotated[
        Path | None,
        Option(
            "Folder of the photographs: its name in the scene, such as images_2, or any path. Default: the "
            "folder of the dataset, otherwise the folder with the largest images.",
            ("--image-folder", "--images"),
            metavar="NAME|FOLDER",
        ),
    ] = None
    scale: Annotated[
        float | None,
        Option("Size of the images relative to the cameras, as in msb render.", metavar="FACTOR"),
    ] = None
    layout: Annotated[
        Literal["side", "wipe", "difference"],
        Option("Layout of the image. This is also the first layout of the page."),
    ] = "side"
    tiers: Annotated[
        tuple[str, ...],
        Option(
            "Tiers to show: reference, dedicated, standard, baked, truth (photographs). Default: all.",
            metavar="TIERS",
        ),
    ] = ()
    baked: Annotated[
        Path | None, Option("Also show this mesh, made by msb bake from the model.", metavar="FILE")
    ] = None
    pair: Annotated[
        str | None, Option("The two tiers to compare in the layouts wipe and difference.", metavar="A,B")
    ] = None

    def __post_init__(self) -> None:
        if self.scale is not None:
            check_factor(self.scale)


@command(
    "msb compare --html out/compare.html data_stubs/checkpoint",
    "msb compare --layout wipe --screenshot out/w.png data_stubs/checkpoint",
    "msb compare --tiers dedicated,standard --html out/c.html \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
    "msb compare --scene data_stubs/scenes/nerf_synthetic/pebble \\\n"
    "      --tiers dedicated,truth --html out/s.html \\\n"
    "      data_stubs/models/pebble/two_dts",
)
def compare(
    path: Source,
    window: Annotated[Window, ("screenshot", "html", "up", "size")],
    views: Annotated[ViewOptions, ("cameras", "camera", "background", "kind")],
    options: CompareOptions,
    reading: Annotated[SceneOptions, ("dataset", "resolution", "camera_convention")],
    drawing: Annotated[RendererOptions, ("assignments", "supersample", "device")],
    output: PlainOutput,
    typed: Typed,
) -> None:
    """Compare the renderer tiers of a model with each other and with the photographs of the dataset.

    Images are shown side by side, with a wipe, or as a map of their difference with the PSNR. --html writes a
    page of all views, which can switch between these layouts. --screenshot writes an image of the first view.
    If neither --cameras nor --scene is given, the command uses the training cameras next to the model. A
    model without training cameras is shown in views from a turntable.
    """
    if options.scene is not None:
        typed.reject(["cameras"], "cannot be combined with --scene, which has its own cameras")
    elif views.cameras is None:
        typed.reject(["camera", "image_folder", "scale"], f"{NO_CAMERAS} or --scene DIR")
    if options.scene is None:
        typed.reject([name for name in SCENE_OPTIONS if name != "image_folder"], NO_SCENE)
    if options.scene is not None or views.cameras is not None:
        typed.reject(["kind"], ONLY_GENERATED)
    require(window.written, "Missing output. Pass --html FILE.html or --screenshot FILE.png")
    from msb.api.command_files import open_asset, open_baked
    from msb_viewers.deployment.comparing import Request, write

    asset = open_asset(path, output)
    request = Request(
        cameras=views,
        scene=options.scene,
        reading=reading,
        background=None if views.background is None else views.color(asset),
        image_folder=options.image_folder,
        scale=options.scale,
        layout=options.layout,
        tiers=options.tiers,
        baked=None if options.baked is None else open_baked(options.baked, asset, output),
        pair=options.pair,
        settings=drawing.settings(asset),
        supersample=drawing.supersample,
        device=drawing.device,
        up=window.up,
    )
    state = request.read(asset, path, output.note)
    write(state, window.html, window.screenshot, window.pixels, output.counted)
    if not output.quiet:
        echo("\n".join(map(str, window.written)))
