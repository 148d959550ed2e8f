"""Colours, line styles and markers of all kinds of elements.

The colours are from Okabe and Ito (Color Universal Design, 2008). People with common kinds of colour
blindness can distinguish these colours. The styles of two kinds of elements always differ by more than their
colour.
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
SEAM: Color = (150, 230, 30)

BACKGROUND: Color = (246, 246, 244)
# The colour of a mesh without colours, and of the largest component.
NEUTRAL: Color = (205, 205, 205)
# The colour of the ring around the selected element. The colour differs clearly from the colours of all
# layers.
HIGHLIGHT: Color = (200, 0, 110)
# The colours of the fans of faces around a vertex. Each fan of faces also has a number, in addition to its
# colour.
FAN_COLORS = (SKY, ORANGE, GREEN, PURPLE, YELLOW, VERMILLION, BLUE)


@dataclass(frozen=True)
class Style:
    """The style of a layer, and the key that shows or hides the layer.

    `kind` is the name of the elements in the audit (docs/definitions.md). `width` of lines and `size` of
    markers are in pixels at the closest zoom. Lines with width 0 are not drawn.
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


# The layers in the order of the legend.
STYLES: dict[str, Style] = {
    style.kind: style
    for style in (
        Style("boundary_edges", "Boundary edges", "1", BLUE, "edge", width=2.0),
        Style("nonmanifold_edges", "Non-manifold edges", "2", VERMILLION, "edge", width=5.0),
        Style("multifan_vertices", "Bow-tie vertices", "3", PURPLE, "vertex", marker="disc", size=15),
        Style(
            "nonmanifold_edge_endpoints",
            "Ends of non-manifold edges",
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
        Style(
            "inconsistent_winding_edges", "Inconsistent winding", "7", GREEN, "edge", width=2.5, line="dashed"
        ),
        Style(
            "unreferenced_vertices",
            "Unused vertices",
            "8",
            (110, 110, 110),
            "vertex",
            marker="ring",
            size=9,
        ),
        Style("seam_edges", "Seams (no defect)", "9", SEAM, "edge", width=4.0, line="dashed"),
    )
}

DELETED: Color = (217, 26, 26)
ADDED: Color = (26, 166, 60)
# The layers of a comparison of a mesh before and after a repair.
REPAIR_STYLES: dict[str, Style] = {
    style.kind: style
    for style in (
        Style("deleted_faces", "Deleted faces", "1", DELETED, "face", width=3.0, marker="cross", size=13),
        Style("added_faces", "Added faces", "2", ADDED, "face", width=3.0, marker="square", size=11),
        Style("cut_edges", "Cut edges", "3", (0, 0, 140), "edge", width=4.0),
    )
}

# Size classes of all components except the largest: lowest and highest number of faces (inclusive), and
# colour.
SIZE_CLASSES: tuple[tuple[int, int | None, Color], ...] = (
    # Colours are ordered from light to dark, so that the order is visible without hue. The colours are from
    # the scale plasma of matplotlib (van der Walt and Smith, 2015). All colours differ clearly from the
    # neutral grey.
    (1, 1, (240, 249, 33)),
    (2, 3, (253, 180, 47)),
    (4, 9, (237, 121, 83)),
    (10, 99, (189, 55, 134)),
    (100, 999, (114, 1, 168)),
    (1000, None, (13, 8, 135)),
)


def size_label(low: int, high: int | None) -> str:
    """Return the label of a size class.

    >>> size_label(2, 3), size_label(1, 1), size_label(1000, None)
    ('2 to 3 faces', '1 face', '1,000 faces or more')
    """
    if high is None:
        return f"{low:,} faces or more"
    return f"{low} face{'' if low == 1 else 's'}" if low == high else f"{low} to {high} faces"


def unit(color: Color) -> tuple[float, float, float]:
    """Return a colour as three floats in [0, 1]."""
    return color[0] / 255, color[1] / 255, color[2] / 255
