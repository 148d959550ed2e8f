"""The table of mesh diagnostics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.report.collect import SOUP
from msb.report.layout import make_table, metric_columns
from msb.report.numbers import MEAN, Key, Numbers, dataset_title, method_title
from msb.report.safe_names import slug
from msb.report.tables.scenes import scene_lines

if TYPE_CHECKING:
    from msb.report.table import Column, Table

CONNECTIVITY = {
    "Local reuse": ("vf_ratio", "mean_valence"),
    "Local structure": ("boundary_edge_ratio", "nonmanifold_edge_ratio", "nonmanifold_vertex_ratio"),
    "Global connectivity": ("lcc_face_ratio", "lcc_area_ratio", "components"),
}
"""The paper's three groups of its eight columns."""
STATEMENTS = (
    "of the mesh as it is stored: nothing was merged, removed or repaired before",
    "a boundary may be legitimate: of an open scene, of a sheet, of what no camera saw",
    "the number of components depends on the resolution of the mesh and on the scene",
    "self-intersections are not looked at",
)
"""What must be known to read them (paper, "Interpretation")."""


def connectivity_columns() -> list[Column]:
    """Return the columns of the diagnostics of a mesh."""
    return [column for block, metrics in CONNECTIVITY.items() for column in metric_columns(metrics, block)]


def mesh_connectivity(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the audit of every exported mesh of a dataset, soups last. The mean is bold."""

    def is_soup(method: str) -> bool:
        mean = Key(dataset, MEAN, method, "exported_mesh", "nonmanifold_vertex_ratio")
        return SOUP in numbers.number(mean).notes

    methods = sorted(numbers.methods(dataset, "exported_mesh"), key=is_soup)
    who = "" if len(methods) != 1 else f" of {method_title(methods[0])}"
    return make_table(
        numbers,
        paper,
        f"mesh_connectivity-{slug(dataset)}",
        f"{dataset_title(dataset)}: the structure of the exported meshes{who}, as stored.",
        ("Scene",),
        connectivity_columns(),
        [
            line
            for method in methods
            for line in scene_lines(
                numbers,
                dataset,
                groups=("outdoor_mean", "indoor_mean"),
                group_means=False,
                prefix=method_title(method) if len(methods) > 1 else "",
                of={"method": method},
            )
        ],
        {"dataset": dataset, "condition": "exported_mesh"},
        definitions=STATEMENTS,
    )
