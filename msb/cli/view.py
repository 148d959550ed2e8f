"""`msb view`: see what is wrong with a mesh, on a window or in a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msb.cli.options import WRITTEN, Force, Quiet, Verbose, epilog, refuse
from msb.cli.output import Output, echo
from msb.cli.window import (
    DEFAULT_SIZE,
    Files,
    Html,
    Screenshot,
    Up,
    UpAxis,
    WindowSize,
    open_probe,
    parse_window_size,
)
from msb.errors import UsageError, about

if TYPE_CHECKING:
    from msb_viewers.model import ViewModel
    from msb_viewers.state import ViewState
    from msb_viewers.viewed_mesh import ViewedMesh

EPILOG = epilog(
    "msb view data_stubs/splat_like.triasset",
    "msb view --screenshot out/view.png --show all data_stubs/checkpoint",
    "msb view --figure out/f.png --html out/f.html data_stubs/checkpoint",
    "msb view --at nonmanifold_edges:17 data_stubs/splat_like.triasset",
    "msb view data_stubs/splat_like.triasset --repaired out/repaired.triasset",
)
Colors = Literal["own", "components", "grey"]


@dataclass(frozen=True)
class ViewOptions:
    """What to show at first, as the command line has it."""

    show: tuple[str, ...] = ()
    at: str | None = None
    vertex: int | None = None
    component: int | None = None
    colors: Colors | None = None
    up: UpAxis | None = None
    size: tuple[int, int] = (1280, 800)


def view(
    path: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    repaired: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT", help="Show what a repair of ASSET, OUT, deleted, added and cut, as the layers."
        ),
    ] = None,
    screenshot: Screenshot = None,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the four-panel figure: .png, .svg or .pdf."),
        WRITTEN,
    ] = None,
    html: Html = None,
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
    colors: Annotated[
        Colors | None, typer.Option(help="How the mesh is coloured. Default: its own colours.")
    ] = None,
    up: Up = None,
    size: WindowSize = DEFAULT_SIZE,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """See what is wrong with a mesh: edges, vertices, faces and components the audit complains about.

    The command opens a window; with --screenshot, --figure or --html it writes these instead and needs no
    display. Layers: boundary_edges, nonmanifold_edges, multifan_vertices, nonmanifold_edge_endpoints,
    degenerate_faces, duplicate_faces, inconsistent_winding_edges, unreferenced_vertices; with --repaired
    deleted_faces (red), added_faces (green), cut_edges.

    msb compare shows what deployment makes of a model's look; msb web writes a page that shows it as engines
    do.
    """
    output = Output(None, quiet, verbose, force)
    files = Files(screenshot, figure, html)
    options = ViewOptions(
        tuple(show or ()),
        at,
        vertex,
        None if component is None else component - 1,
        colors,
        up,
        parse_window_size(size),
    )
    if repaired is not None:
        refuse({"figure": figure}, "does not go with --repaired; there is --screenshot")
    files.check(output)
    probe = open_probe(files)
    try:
        model = _read(path, output) if repaired is None else _read_repaired(path, repaired, output)
        if probe is not None:
            probe.check()
    finally:
        if probe is not None:
            probe.close()
    present(model, options, files, output)


def present(model: ViewModel, options: ViewOptions, files: Files, output: Output) -> None:
    """Write what is asked for, or open the window and return when it is closed."""
    state = initial_state(model, options)
    for note in model.notes:
        output.note(f"{model.name}: {note}")
    written = [path for path in (files.html, files.figure, files.screenshot) if path is not None]
    if files.html is not None:
        from msb_viewers.page import LARGE, write_page

        if len(model.faces) > LARGE:
            output.note(f"warning: {files.html}: {len(model.faces):,} faces are more than most browsers hold")
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
    """Return the state the options describe."""
    from msb_viewers.state import ViewState, parse_element, parse_kinds

    state = ViewState.first(model)
    if options.show:
        state.visible = parse_kinds(model, options.show)
        state.active = next((kind for kind in model.layers if kind in state.visible), state.active)
    if options.colors is not None:
        if options.colors == "own" and model.colors is None:
            raise UsageError("NAME_UNKNOWN", "--colors own: the mesh has no colours of its own")
        state.coloring = options.colors
    if options.component is not None:
        count = len(model.sizes)
        if options.component >= count:
            text = f"--component {options.component + 1}: there are {count}"
            raise UsageError("NAME_UNKNOWN", text)
        state.isolate(options.component)
    if options.at is not None and options.vertex is not None:
        raise UsageError("USAGE", "--at and --vertex exclude each other")
    if options.at is not None:
        state.choose(*parse_element(model, options.at))
    if options.vertex is not None:
        count = len(model.points)
        if options.vertex >= count:
            text = f"--vertex {options.vertex}: the last vertex is {count - 1}"
            raise UsageError("NAME_UNKNOWN", text)
        state.choose_vertex(options.vertex)
    return state


def _read(path: Path, output: Output) -> ViewModel:
    return model_of(_read_mesh(path, output), output)


def _read_repaired(path: Path, repaired: Path, output: Output) -> ViewModel:
    from msb_viewers.repaired import build_repaired_model

    before, after = _read_mesh(path, output), _read_mesh(repaired, output)
    with output.progress(f"comparing {before.name} with {after.name}"):
        return build_repaired_model(before, after)


def _read_mesh(path: Path, output: Output) -> ViewedMesh:
    from msb.cli.inputs import expand
    from msb_viewers.viewed_mesh import read_viewed_mesh

    found = expand(path)
    if len(found) > 1:
        names = ", ".join(one.name for one in found[:4])
        raise UsageError("USAGE", f"one mesh at a time; this folder holds {len(found)}: {names}", file=path)
    with output.progress(f"reading {found[0].name}"):
        return read_viewed_mesh(found[0])


def model_of(mesh: ViewedMesh, output: Output) -> ViewModel:
    """Return what is to be shown of a mesh, audited."""
    from msb.topology import audit_arrays
    from msb_viewers.model import build_model

    with output.progress(f"auditing {mesh.name}: {len(mesh.faces):,} faces"), about(mesh.path):
        return build_model(mesh, *audit_arrays(mesh.vertices, mesh.faces))
