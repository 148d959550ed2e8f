"""The paper's figure of topology diagnostics, for any mesh.

Each of the figure's four columns has an overview and a close-up.
"""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb_viewers.camera import Pose, element_pose
from msb_viewers.palette import NEUTRAL, STYLES, unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from msb_viewers.model import ViewModel
    from msb_viewers.viewer import TopologyViewer

# Side of an image in pixels: 3.2 inches on paper at 200 dots per inch.
_SIDE = 640
# Factor for the camera distance of a close-up. The function `element_pose` returns the camera distance for
# factor 1.
_CLOSER = 0.9
# Dots per inch of the figure's file.
_DPI = 130
# Scale of lines and markers in the figure. Each image of the figure is later scaled down to about 400 pixels.
_BOOST = 1.4


@dataclass(frozen=True)
class Column:
    """A column of the figure."""

    title: str
    # The drawn layers of a column.
    kinds: tuple[str, ...]
    # The colouring of the mesh.
    coloring: str
    # The text that replaces the close-up if the mesh has no element of the column's kind.
    nothing: str


COLUMNS = (
    Column("(a) Boundary edges", ("boundary_edges",), "grey", "no boundary edges"),
    Column("(b) Non-manifold edges", ("nonmanifold_edges",), "grey", "no non-manifold edges"),
    Column(
        "(c) Non-manifold vertices",
        ("multifan_vertices", "nonmanifold_edge_endpoints"),
        "grey",
        "no non-manifold vertices",
    ),
    Column("(d) Edge-connected components", (), "components", "one component"),
)


def write_figure(model: ViewModel, path: Path, *, up: str | None = None, dpi: int = _DPI) -> None:
    """Write the figure: each diagnosis on the whole mesh, and as a close-up of an example."""
    from msb.base.atomic import new_file

    need_extra("view", "matplotlib", what="a figure")
    buffer = io.BytesIO()
    kind = path.suffix.lower()[1:]
    # The file contains no date, so equal meshes give equal bytes.
    stamp: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    compose(model, render_columns(model, up)).savefig(
        buffer, format=kind, dpi=dpi, metadata=stamp[kind], facecolor="white"
    )
    with new_file(path) as file:
        file.write(buffer.getvalue())


def render_columns(
    model: ViewModel, up: str | None = None, side: int = _SIDE
) -> list[tuple[NDArray[np.uint8], NDArray[np.uint8] | None]]:
    """Return an overview and a close-up for each column, (side, side, 3) uint8. A close-up can be None."""
    from msb_viewers.viewer import TopologyViewer

    viewer = TopologyViewer(model, size=(side, side), off_screen=True, up=up)
    try:
        viewer.plotter.set_background("white")
        viewer.stage.boost = _BOOST
        return [_render_column(viewer, column) for column in COLUMNS]
    finally:
        viewer.close()


def _render_column(
    viewer: TopologyViewer, column: Column
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    model, state = viewer.model, viewer.state
    state.legend, state.message = False, ""
    state.coloring = column.coloring  # type: ignore[assignment]
    state.visible = {kind for kind in column.kinds if len(model.layers[kind])}
    if model.soup:
        state.visible.discard("boundary_edges")
    viewer.home()
    whole = viewer.image()
    pose = _close_up(viewer, column)
    if pose is None:
        return whole, None
    viewer.pose = pose
    return whole, viewer.image()


def _close_up(viewer: TopologyViewer, column: Column) -> Pose | None:
    """Return the camera pose for a close-up of the element nearest to the camera.

    Elements in the largest component are preferred.
    """
    model = viewer.model
    if column.kinds:
        visible = [kind for kind in column.kinds if kind in viewer.state.visible]
        if not visible:
            return None
        rows = model.rows(visible[0], 0)
        rows = rows if len(rows) else model.rows(visible[0])
        candidates = model.layers[visible[0]].vertices[rows]
    else:
        if len(model.sizes) < 2:
            return None
        # Find faces of the components from the second largest to the thirteenth largest.
        first = np.flatnonzero((model.face_component >= 1) & (model.face_component <= 12) & model.drawn)
        candidates = model.faces[first]
    if len(candidates) == 0:
        return None
    middles = model.points[candidates].mean(axis=1)
    nearest = int(np.argmin(np.linalg.norm(middles - viewer.pose.eye, axis=1)))
    pose = element_pose(model, candidates[nearest], viewer.pose)
    if pose is None:
        return None
    return Pose(pose.target + _CLOSER * (pose.eye - pose.target), pose.target, pose.up)


def compose(model: ViewModel, images: list[tuple[NDArray[np.uint8], NDArray[np.uint8] | None]]) -> Figure:
    """Return the matplotlib figure of four columns with titles, counts and legends."""
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # matplotlib would warn about a read-only cache
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    close = any(pair[1] is not None for pair in images)
    rows = 2 if close else 1
    figure = Figure(figsize=(13.2, 7.9 if close else 4.5), facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, 4, left=0.012, right=0.988, bottom=0.1 if close else 0.17, top=0.925 if close else 0.86,
        wspace=0.035, hspace=0.035,
    )  # fmt: skip
    for number, (column, pair) in enumerate(zip(COLUMNS, images, strict=True)):
        for row, image in enumerate(pair[:rows]):
            axes = figure.add_subplot(grid[row, number])
            axes.set_xticks([])
            axes.set_yticks([])
            for spine in axes.spines.values():
                spine.set_color("#b4b6ba")
            if image is None:
                axes.text(
                    0.5, 0.5, _placeholder(model, column), ha="center", va="center", fontsize=11, wrap=True
                )
                axes.set_xlim(0, 1)
                axes.set_ylim(0, 1)
                axes.set_box_aspect(1)
            else:
                axes.imshow(image)
            if row == 0:
                axes.set_title(f"{column.title}\n", fontsize=12, fontweight="bold", pad=4)
                axes.text(0.5, 1.02, _count(model, column), ha="center", va="bottom", fontsize=10,
                          transform=axes.transAxes)  # fmt: skip
            if row == rows - 1:
                _legend(axes, model, column)
    return figure


def _placeholder(model: ViewModel, column: Column) -> str:
    if model.soup and "boundary_edges" in column.kinds:
        return "triangle soup: no vertices are shared, so every edge is a boundary edge"
    return column.nothing


def _count(model: ViewModel, column: Column) -> str:
    from msb.topology.verdict import percent

    counts = model.audit.judged.counts
    if column.coloring == "components":
        largest = percent(counts.largest_component_faces, counts.faces)
        return f"{counts.components:,}; the largest has {largest} of the faces"
    if len(column.kinds) > 1:
        part, whole, what = counts.nonmanifold_vertices, counts.vertices, "vertices"
    else:
        part, whole, what = len(model.layers[column.kinds[0]]), counts.edges, "edges"
    return f"{part:,} of {whole:,} {what} ({percent(part, whole)})"


def _legend(axes: Any, model: ViewModel, column: Column) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    shapes = {"disc": "o", "diamond": "D"}
    names = {
        "boundary_edges": "boundary edge (one face)",
        "nonmanifold_edges": "non-manifold edge (more than two faces)",
        "multifan_vertices": "vertex with several fans (bow-tie): {:,}",
        "nonmanifold_edge_endpoints": "vertex of a non-manifold edge: {:,}",
    }
    handles: list[Any] = []
    for kind in column.kinds:
        style = STYLES[kind]
        look: dict[str, Any] = {"linewidth": style.width * 0.8}
        if style.marker:
            look = {"marker": shapes[style.marker], "markersize": style.size * 0.55}
            look |= {"markeredgecolor": "black", "linestyle": "none"}
        label = names[kind].format(len(model.layers[kind]))
        handles.append(Line2D([], [], color=unit(style.color), label=label, **look))
    if column.coloring == "components":
        from msb_viewers.palette import size_label

        handles.append(Patch(facecolor=unit(NEUTRAL), edgecolor="black", linewidth=0.5, label="largest"))
        for group in reversed(model.size_classes()):
            label = f"{size_label(group.low, group.high).replace(' faces', '').replace(' face', '')}"
            handles.append(Patch(facecolor=unit(group.color), edgecolor="black", linewidth=0.5, label=label))
    columns = 4 if column.coloring == "components" else 1
    title = "faces in a component" if column.coloring == "components" else None
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.015), frameon=False, fontsize=9.5,
        ncols=columns, title=title, title_fontsize=9.5, handlelength=1.6, columnspacing=1, borderaxespad=0.2,
    )  # fmt: skip
