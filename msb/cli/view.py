"""`msb view`: see what is wrong with a mesh, or what deployment does to it, on a window or in a file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.cli.options import DeviceName, Force, Quiet, Verbose, epilog
from msb.cli.output import Output, echo
from msb.cli.view_compare import CompareOptions, Layout, compare
from msb.cli.view_web import write_web
from msb.cli.views import Assignments, Cameras, Chosen, Scale
from msb.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msb_viewers.gl import GlProbe
    from msb_viewers.model import ViewModel
    from msb_viewers.source import Source
    from msb_viewers.state import ViewState

EPILOG = epilog(
    "msb view data_stubs/splat_like.triasset",
    "msb view --screenshot out/view.png --show all data_stubs/checkpoint",
    "msb view --figure out/f.png --html out/f.html data_stubs/checkpoint",
    "msb view --at nonmanifold_edges:17 data_stubs/splat_like.triasset",
    "msb view --compare --cameras data_stubs/views.json data_stubs/checkpoint",
    "msb view --web w.html --cameras data_stubs/views.json data_stubs/checkpoint",
    "msb view --compare --layout wipe --screenshot w.png data_stubs/checkpoint",
)
Up = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Colors = Literal["own", "components", "grey"]
MOST_PIXELS = 16384
"""Width or height of a picture; more is beyond what GL can draw."""


@dataclass(frozen=True)
class ViewOptions:
    """What to show at first, as the command line has it."""

    show: tuple[str, ...] = ()
    at: str | None = None
    vertex: int | None = None
    component: int | None = None
    colors: Colors | None = None
    up: Up | None = None
    size: tuple[int, int] = (1280, 800)


def view(
    path: Annotated[
        Path | None, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")
    ] = None,
    screenshot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write what the window would show to a .png.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the four-panel figure: .png, .svg or .pdf.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page that any browser opens, offline.")
    ] = None,
    show: Annotated[
        list[str] | None,
        typer.Option(metavar="LAYERS", help="Layers that are on: names, all or none. May be given again."),
    ] = None,
    at: Annotated[
        str | None, typer.Option(metavar="LAYER:N", help="Fly to the N-th element of a layer.")
    ] = None,
    vertex: Annotated[
        int | None, typer.Option(metavar="V", min=0, help="Draw the fans of vertex V apart.")
    ] = None,
    component: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Show only the N-th largest component.")
    ] = None,
    colors: Annotated[Colors | None, typer.Option(help="How the mesh is coloured; its own colours.")] = None,
    up: Annotated[Up | None, typer.Option(help="Axis that points up; the asset's.")] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the window in pixels.")] = "1280x800",
    deployment: Annotated[
        bool,
        typer.Option("--compare", help="Compare what the paths of deployment make of its look, instead."),
    ] = False,
    web: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a page of three.js that shows the mesh as engines do."),
    ] = None,
    cameras: Cameras = None,
    chosen: Chosen = None,
    images: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="The cameras' photographs; where the dataset says.")
    ] = None,
    scale: Scale = None,
    layout: Annotated[Layout | None, typer.Option(help="How paths are shown at first; side.")] = None,
    paths: Annotated[
        list[str] | None,
        typer.Option(metavar="PATHS", help="Of truth, reference, dedicated, standard. Default: all."),
    ] = None,
    pair: Annotated[
        str | None, typer.Option(metavar="A,B", help="Paths that wipe and difference show at first.")
    ] = None,
    background: Annotated[str | None, typer.Option(metavar="COLOR", help="As of msb render; white.")] = None,
    assignments: Assignments = None,
    supersample: Annotated[
        int | None, typer.Option(min=1, max=16, help="Samples along each side of a pixel, standard tier.")
    ] = None,
    device: DeviceName = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """See what is wrong with a mesh: edges, vertices, faces and components the audit complains about.

    Opens a window; with --screenshot, --figure or --html it writes these instead and needs no display.
    Layers: boundary_edges, nonmanifold_edges, multifan_vertices, nonmanifold_edge_endpoints,
    degenerate_faces, duplicate_faces, inconsistent_winding_edges, unreferenced_vertices.

    With --compare: reference, dedicated and standard tier, and the dataset's photographs, side by side,
    with a wipe, or as a map of their difference with its PSNR. Options from --cameras to --device belong
    to it.

    With --web: a page any browser opens offline, which orbits the mesh and has the cameras in a list; without
    an ASSET it waits for a .glb to be dropped.
    """
    output = Output(None, quiet, verbose, force)
    files = Files(screenshot, figure, html)
    topology = {"show": show, "at": at, "vertex": vertex, "component": component, "colors": colors}
    deploying = {
        "cameras": cameras, "camera": chosen, "images": images, "scale": scale, "layout": layout,
        "paths": paths, "pair": pair, "background": background, "set": assignments,
        "supersample": supersample, "device": device,
    }  # fmt: skip
    if web is not None:
        shared = {name: deploying.pop(name) for name in ("cameras", "camera", "scale", "background", "set")}
        _refuse(topology | deploying | asdict(files), "does not go with --web")
        _refuse({"compare": deployment or None}, "does not go with --web")
        if path is None:
            _refuse({**shared, "up": up}, "needs an ASSET")
        if cameras is None:
            _refuse({"camera": chosen, "scale": scale}, "needs --cameras")
        write_web(
            web, path, output, cameras=cameras, chosen=chosen, scale=scale, background=background,
            assignments=assignments, up=up,
        )  # fmt: skip
        return
    if path is None:
        raise UsageError("USAGE", "Missing argument 'ASSET'.")
    if deployment:
        _refuse({**topology, "figure": figure}, "shows the topology and does not go with --compare")
        files.check(output)
        need_viewers()
        compare(
            path,
            CompareOptions(
                cameras, chosen, images, scale, layout or "side", paths, pair, background or "white",
                assignments, supersample or 1, device, up, _size(size),
            ),
            files,
            output,
        )  # fmt: skip
        return
    _refuse(deploying, "needs --compare")
    options = ViewOptions(
        tuple(show or ()), at, vertex, None if component is None else component - 1, colors, up, _size(size)
    )
    files.check(output)
    probe = open_probe(files)
    try:
        model = _read(path, output)
        if probe is not None:
            probe.check()
    finally:
        if probe is not None:
            probe.close()
    present(model, options, files, output)


def _refuse(given: Mapping[str, object], why: str) -> None:
    """Refuse options that would be ignored."""
    for name, value in given.items():
        if value is not None:
            raise UsageError("USAGE", f"--{name} {why}")


@dataclass(frozen=True)
class Files:
    """What is to be written; nothing means a window."""

    screenshot: Path | None = None
    figure: Path | None = None
    html: Path | None = None

    @property
    def any(self) -> bool:
        """Whether something is to be written."""
        return any(path is not None for path in (self.screenshot, self.figure, self.html))

    def check(self, output: Output) -> None:
        """Refuse names that cannot be, before anything is read."""
        for option, path, suffixes in (
            ("--screenshot", self.screenshot, (".png",)),
            ("--figure", self.figure, (".png", ".svg", ".pdf")),
            ("--html", self.html, (".html", ".htm")),
        ):
            if path is not None and path.suffix.lower() not in suffixes:
                text = f'{option}: "{path.name}" must end in {", ".join(suffixes)}'
                raise UsageError("USAGE", text)
            output.check_free(path)


def open_probe(files: Files) -> GlProbe | None:
    """Ask whether there is something to draw with and on, if that is needed; the answer comes later.

    Raises
    ------
    UsageError
        `EXTRA_MISSING`, `VIEW_NO_DISPLAY`.
    """
    need_viewers()
    from msb_viewers.gl import GlProbe, check_display

    if files.any and files.screenshot is None and files.figure is None:
        return None  # a page needs neither
    probe = GlProbe.start()
    if not files.any:
        try:
            check_display()
        except UsageError:
            probe.close()
            raise
    return probe


def need_viewers() -> None:
    """Refuse to go on without the package of the viewers.

    Raises
    ------
    UsageError
        `EXTRA_MISSING`.
    """
    from importlib.util import find_spec

    if find_spec("msb_viewers") is None:
        text = 'the viewers are not installed; pip install "meshsplatbench[view]" brings them'
        raise UsageError("EXTRA_MISSING", text)


def present(model: ViewModel, options: ViewOptions, files: Files, output: Output) -> None:
    """Write what is asked for, or open the window and return when it is closed."""
    state = initial_state(model, options)
    output.note(f"{model.name}: {model.nbytes() / 1e6:.0f} MB of arrays", level=1)
    for note in model.notes:
        output.note(f"{model.name}: {note}")
    written = [path for path in (files.html, files.figure, files.screenshot) if path is not None]
    if files.html is not None:
        from msb_viewers.page import LARGE, write_page

        if len(model.faces) > LARGE:
            output.note(f"{files.html}: {len(model.faces):,} faces are more than most browsers hold")
        with output.progress(f"writing {files.html.name}"):
            write_page(model, files.html, state=state, up=options.up)
    if files.figure is not None:
        from msb_viewers.figure import write_figure

        with output.progress(f"writing {files.figure.name}"):
            write_figure(model, files.figure, up=options.up)
    if files.screenshot is not None or not files.any:
        from msb_viewers.viewer import TopologyViewer

        viewer = TopologyViewer(model, size=options.size, off_screen=files.any, up=options.up, state=state)
        try:
            if options.at is not None or options.vertex is not None:
                viewer.fly_to_chosen()
            elif options.component is not None:
                viewer.fly_to_component()
            if files.screenshot is not None:
                viewer.screenshot(files.screenshot)
            else:
                viewer.show()
        finally:
            viewer.close()
    if written and not output.quiet:
        echo("\n".join(map(str, written)))


def initial_state(model: ViewModel, options: ViewOptions) -> ViewState:
    """Return the state the options describe.

    Raises
    ------
    UsageError
        `VIEW_ELEMENT`.
    """
    from msb_viewers.state import ViewState, parse_element, parse_kinds

    state = ViewState.first(model)
    if options.show:
        state.visible = parse_kinds(model, options.show)
        state.active = next((kind for kind in model.layers if kind in state.visible), state.active)
    if options.colors is not None:
        if options.colors == "own" and model.colors is None:
            raise UsageError("VIEW_ELEMENT", "--colors own: the mesh has no colours of its own")
        state.coloring = options.colors
    if options.component is not None:
        count = len(model.sizes)
        if options.component >= count:
            text = f"--component {options.component + 1}: there are {count}"
            raise UsageError("VIEW_ELEMENT", text, value=options.component + 1, limit=count)
        state.isolate(options.component)
    if options.at is not None and options.vertex is not None:
        raise UsageError("USAGE", "--at and --vertex exclude each other")
    if options.at is not None:
        state.choose(*parse_element(model, options.at))
    if options.vertex is not None:
        count = len(model.points)
        if options.vertex >= count:
            text = f"--vertex {options.vertex}: the last vertex is {count - 1}"
            raise UsageError("VIEW_ELEMENT", text, value=options.vertex, limit=count - 1)
        state.choose_vertex(options.vertex)
    return state


def _read(path: Path, output: Output) -> ViewModel:
    from msb.cli.inputs import expand
    from msb_viewers.source import read_source

    found = expand(path)
    if len(found) > 1:
        names = ", ".join(one.name for one in found[:4])
        raise UsageError("USAGE", f"one mesh at a time; this folder holds {len(found)}: {names}", file=path)
    with output.progress(f"reading {found[0].name}"):
        source = read_source(found[0])
    return model_of(source, output)


def model_of(source: Source, output: Output) -> ViewModel:
    """Return what is to be shown of a mesh, audited."""
    from msb.cli.run import about
    from msb.topology import audit_arrays
    from msb_viewers.model import build_model

    with output.progress(f"auditing {source.name}: {len(source.faces):,} faces"), about(source.path):
        return build_model(source, *audit_arrays(source.vertices, source.faces))


def _size(text: str) -> tuple[int, int]:
    from msb.cli.views import parse_size

    width, height = parse_size(text)
    if not (64 <= width <= MOST_PIXELS and 64 <= height <= MOST_PIXELS):
        raise UsageError("USAGE", f"--size is {width}x{height}; it must be from 64 to {MOST_PIXELS} each way")
    return width, height
