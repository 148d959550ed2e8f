"""The two feature tables, built from the registry of methods."""

from collections.abc import Iterable
from dataclasses import fields

from msb.registry import METHODS, Method, Native, Tier
from msb.report.table import NOT_AVAILABLE, NOT_SUPPORTED, Table, TableCell, TableColumn, TableRow

# Titles of fields. All other titles are the capitalised names of the fields.
_TITLES = {"sh": "SH", "view_dependence": "View-dep."}
# For each tier, the fields of `Retained` that are columns of the table. The standard tier is the opaque
# fallback for all methods, and keeps only the appearance.
_FIELDS: dict[Tier, tuple[str, ...]] = {
    "standard": ("support", "appearance"),
    "dedicated": ("support", "view_dependence", "opacity", "soft_coverage", "depth_sort", "appearance"),
}
TIER_TITLES: dict[Tier, str] = {"standard": "Standard deployment", "dedicated": "Dedicated deployment"}


def native_features(methods: Iterable[Method] | None = None) -> Table:
    """Return the table of features of the representations of `methods`.

    By default, all methods are included.
    """
    names = [field.name for field in fields(Native)]
    return Table(
        "method_attributes",
        "Features of the representation and of its native renderer.",
        ("Method",),
        tuple(TableColumn(_title(name)) for name in names),
        tuple(
            TableRow((method.title,), tuple(_feature_cell(getattr(method.native, name)) for name in names))
            for method in (METHODS.values() if methods is None else methods)
            if method.native
        ),
    )


def deployment_features(methods: Iterable[Method] | None = None) -> Table:
    """Return the table of features that each tier keeps for the methods in `methods`.

    By default, all methods are included.
    """
    rows = [
        TableRow(
            (method.title,),
            tuple(_tier_cell(method, tier, name) for tier in _FIELDS for name in _FIELDS[tier]),
        )
        for method in (METHODS.values() if methods is None else methods)
        if method.paper_name or method.retained
    ]
    return Table(
        "feature_mapping",
        "Features kept by each tier. Fallback: opaque triangles with static colours. Method-aware: the "
        "listed functions of the method.",
        ("Method",),
        tuple(TableColumn(_title(name), (TIER_TITLES[tier],)) for tier in _FIELDS for name in _FIELDS[tier]),
        tuple(rows),
        (f"{NOT_AVAILABLE}: the representation does not have the feature", f"{NOT_SUPPORTED}: not supported"),
    )


def _tier_cell(method: Method, tier: Tier, name: str) -> TableCell:
    retained = method.retained.get(tier)
    if retained is None:
        why = method.unsupported.get(tier, "its package does not declare the features of this tier")
        return TableCell(NOT_SUPPORTED, reason=f"{method.title}: {why}")
    notes = (retained.notes[name],) if name in retained.notes else ()
    return _feature_cell(getattr(retained, name), notes)


def _feature_cell(value: bool | str | None, notes: tuple[str, ...] = ()) -> TableCell:
    if value is None:
        return TableCell(NOT_AVAILABLE)
    text = {True: "yes", False: "no"}[value] if isinstance(value, bool) else value
    return TableCell(text, value, notes=notes)


def _title(name: str) -> str:
    return _TITLES.get(name, name.replace("_", " ").capitalize())
