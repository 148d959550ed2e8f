"""`msb view`: show the defects of a mesh in a window or in a file."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msb.base.option import Option
from msb.cli.command import command, require
from msb.cli.output import Output, PlainOutput, echo
from msb.errors import UsageError, about
from msb.render.options import Source
from msb_viewers.commands.window import Window, open_probe
from msb_viewers.options import ViewOptions

if TYPE_CHECKING:
    from msb_viewers.model import ViewModel
    from msb_viewers.viewed_mesh import ViewedMesh


@command(
    "msb view data_stubs/splat_like.triasset",
    "msb view --screenshot out/view.png --show all data_stubs/checkpoint",
    "msb view --figure out/f.png --html out/f.html data_stubs/checkpoint",
    "msb view --at nonmanifold_edges:17 data_stubs/splat_like.triasset",
    "msb view data_stubs/splat_like.triasset --repaired out/repaired.triasset",
)
def view(
    path: Source,
    *,
    repaired: Annotated[
        Path | None,
        Option(
            "Show deleted and added faces and cut edges of OUT, a repaired version of ASSET.", metavar="OUT"
        ),
    ] = None,
    window: Window,
    options: ViewOptions,
    output: PlainOutput,
) -> None:
    """Show the defects of a mesh: edges, vertices, faces and components that the audit reports.

    The command opens a window. With --screenshot, --figure or --html, the command writes files without
    opening a window, and needs no display. Layers: boundary_edges, nonmanifold_edges, multifan_vertices,
    nonmanifold_edge_endpoints, degenerate_faces, duplicate_faces, inconsistent_winding_edges,
    unreferenced_vertices; with --repaired deleted_faces (red), added_faces (green), cut_edges.

    Use msb compare to compare renderer tiers, and msb web to show the mesh as engines draw it.
    """
    both = repaired is not None and window.figure is not None
    require(not both, "--figure cannot be combined with --repaired; use --screenshot")
    probe = open_probe(window)
    try:
        model = _audit_mesh(path, output) if repaired is None else _read_repaired(path, repaired, output)
        if probe is not None:
            probe.check()
    finally:
        if probe is not None:
            probe.close()
    present(model, options, window, output)


def present(model: ViewModel, options: ViewOptions, window: Window, output: Output) -> None:
    """Write the requested files, or open a window and return when it is closed."""
    from msb_viewers.state import ViewState

    state = ViewState.of(model, options)
    for note in model.notes:
        output.note(f"{model.name}: {note}")
    if window.html is not None:
        from msb_viewers.page import LARGE, write_page

        if len(model.faces) > LARGE:
            output.note(f"warning: {window.html}: {len(model.faces):,} faces are too many for most browsers")
        with output.progress(f"writing {window.html.name}"):
            write_page(model, window.html, state=state, up=window.up)
    if window.figure is not None:
        from msb_viewers.figure import write_figure

        with output.progress(f"writing {window.figure.name}"):
            write_figure(model, window.figure, up=window.up)
    if window.screenshot is not None or not window.written:
        with ExitStack() as stack:
            with output.progress(f"drawing {model.name}"):
                from msb_viewers.viewer import TopologyViewer

                off_screen = window.screenshot is not None
                viewer = TopologyViewer(
                    model, size=window.pixels, off_screen=off_screen, up=window.up, state=state
                )
                stack.callback(viewer.close)
                if options.at is not None:
                    viewer.fly_to_selection()
                elif options.component is not None:
                    viewer.fly_to_component()
                if window.screenshot is not None:
                    viewer.screenshot(window.screenshot)
            if window.screenshot is None:
                viewer.show()
    if window.written and not output.quiet:
        echo("\n".join(map(str, window.written)))


def _read_repaired(path: Path, repaired: Path, output: Output) -> ViewModel:
    from msb_viewers.repaired import build_repaired_model

    before, after = _read_mesh(path, output), _read_mesh(repaired, output)
    with output.progress(f"comparing {before.name} with {after.name}"):
        return build_repaired_model(before, after)


def _read_mesh(path: Path, output: Output) -> ViewedMesh:
    from msb.api.inputs import expand
    from msb_viewers.viewed_mesh import read_viewed_mesh

    inputs = expand(path)
    if len(inputs) > 1:
        names = ", ".join(place.name for place in inputs[:4])
        raise UsageError("USAGE", f"it contains {len(inputs)} meshes ({names}); pass one of them", file=path)
    with output.progress(f"reading {inputs[0].name}"):
        return read_viewed_mesh(inputs[0])


def _audit_mesh(path: Path, output: Output) -> ViewModel:
    from msb.topology import audit_arrays
    from msb_viewers.model import build_model
    from msb_viewers.viewed_mesh import merge_seams

    mesh = _read_mesh(path, output)
    with output.progress(f"auditing {mesh.name}: {len(mesh.faces):,} faces"), about(mesh.path):
        audit, stored = audit_arrays(mesh.vertices, mesh.faces, attributes=mesh.attributes)
        if audit.without_seams is None:
            return build_model(mesh, audit, stored)
        merged, analysis = merge_seams(mesh)
        return build_model(merged, audit, analysis, stored)
