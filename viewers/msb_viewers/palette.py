"""How each kind of element looks: a colour and, always, a shape, a line style or a text beside it.

Colours are those of Okabe and Ito (M. Okabe and K. Ito, Color Universal Design, 2008), which stay apart
under the common kinds of colour blindness. No two kinds differ by colour alone.
"""

from dataclasses import dataclass
from typing import Literal

# Red, green and blue, sRGB bytes.
Color = tuple[int, int, int]
Marker = Literal["disc", "diamond", "cross", "square", "ring"]
Line = Literal["solid", "dashed"]

INK: Color = (30, 32, 36)
BLACK: Color = (0, 0, 0)
WHITE: Color = (255, 255, 255)
ORANGE: Color = (230, 159, 0)
SKY: Color = (86, 180, 233)
GREEN: Color = (0, 158, 115)
YELLOW: Color = (240, 228, 66)
BLUE: Color = (0, 114, 178)
VERMILLION: Color = (213, 94, 0)
PURPLE: Color = (204, 121, 167)

BACKGROUND: Color = (246, 246, 244)
# The colour of a mesh without colours, and of the largest component.
NEUTRAL: Color = (205, 205, 205)
# The colour of the ring around the chosen element; no layer's colour is near it.
HIGHLIGHT: Color = (200, 0, 110)
# The colours of the fans of a vertex; each fan also carries its number.
FAN_COLORS = (SKY, ORANGE, GREEN, PURPLE, YELLOW, VERMILLION, BLUE)


@dataclass(frozen=True)
class Style:
    """One layer's look, and the key that switches it.

    `kind` is the audit's name of the elements (docs/definitions.md). `width` of lines and `size` of markers
    are in pixels at the finest zoom; a width of 0 draws none.
    """

    kind: str
    label: str
    key: str
    color: Color
    of: Literal["vertex", "edge", "face"]
    width: float = 0.0
    line: Line = "solid"
    marker: Marker | None = None
    size: float = 0.0


# Layers in the legend's order.
STYLES: dict[str, Style] = {
    style.kind: style
    for style in (
        Style("boundary_edges", "Boundary edges", "1", BLUE, "edge", width=2.0),
        Style("nonmanifold_edges", "Non-manifold edges", "2", VERMILLION, "edge", width=5.0),
        Style("multifan_vertices", "Vertices: several fans", "3", PURPLE, "vertex", marker="disc", size=15),
        Style(
            "nonmanifold_edge_endpoints",
            "Vertices: on a non-m. edge",
            "4",
            ORANGE,
            "vertex",
            marker="diamond",
            size=11,
        ),
        Style(
            "degenerate_faces", "Degenerate faces", "5", YELLOW, "face", width=3.0, marker="cross", size=17
        ),
        Style("duplicate_faces", "Duplicate faces", "6", SKY, "face", width=3.0, marker="square", size=13),
        Style("inconsistent_winding_edges", "Winding flips", "7", GREEN, "edge", width=2.5, line="dashed"),
        Style(
            "unreferenced_vertices",
            "Unused vertices",
            "8",
            (110, 110, 110),
            "vertex",
            marker="ring",
            size=9,
        ),
    )
}

DELETED: Color = (217, 26, 26)
ADDED: Color = (26, 166, 60)
# The layers of a mesh and what a repair made of it, instead.
REPAIR_STYLES: dict[str, Style] = {
    style.kind: style
    for style in (
        Style("deleted_faces", "Deleted faces", "1", DELETED, "face", width=3.0, marker="cross", size=13),
        Style("added_faces", "Added faces", "2", ADDED, "face", width=3.0, marker="square", size=11),
        Style("cut_edges", "Cut edges", "3", (0, 0, 140), "edge", width=4.0),
    )
}

# Components other than the largest by their number of faces: from, to (both included), colour.
SIZE_CLASSES: tuple[tuple[int, int | None, Color], ...] = (
    # Light to dark with size, so that the order survives without hue; steps of the plasma scale of
    # matplotlib (S. van der Walt and N. Smith, 2015), none of them near the neutral grey.
    (1, 1, (240, 249, 33)),
    (2, 3, (253, 180, 47)),
    (4, 9, (237, 121, 83)),
    (10, 99, (189, 55, 134)),
    (100, 999, (114, 1, 168)),
    (1000, None, (13, 8, 135)),
)


def size_label(low: int, high: int | None) -> str:
    """Return the text of a size class.

    >>> size_label(2, 3), size_label(1, 1), size_label(1000, None)
    ('2 to 3 faces', '1 face', '1,000 faces or more')
    """
    if high is None:
        return f"{low:,} faces or more"
    return f"{low} face{'' if low == 1 else 's'}" if low == high else f"{low} to {high} faces"


def unit(color: Color) -> tuple[float, float, float]:
    """Return a colour as three numbers in [0, 1]."""
    return color[0] / 255, color[1] / 255, color[2] / 255
