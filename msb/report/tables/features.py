"""The two feature matrices, made from `msb.registry`."""

from dataclasses import fields

from msb.registry import METHODS, Method, Native, Tier
from msb.report.table import NOT_SUPPORTED, NOT_THERE, Cell, Column, Row, Table

_TITLES = {"sh": "SH", "view_dependence": "View-dep."}
# Tier -> the fields of `Retained` it has columns for: an opaque fallback keeps only appearance.
_SHOWN: dict[Tier, tuple[str, ...]] = {
    "standard": ("support", "appearance"),
    "dedicated": ("support", "view_dependence", "opacity", "soft_coverage", "depth_sort", "appearance"),
}
TIER_TITLES: dict[Tier, str] = {"standard": "Standard deployment", "dedicated": "Dedicated deployment"}


def native_features() -> Table:
    """Return what each method's own representation has."""
    names = [field.name for field in fields(Native)]
    return Table(
        "method_attributes",
        "What the representation and its own renderer have.",
        ("Method",),
        tuple(Column(_title(name)) for name in names),
        tuple(
            Row((method.title,), tuple(_cell(getattr(method.native, name)) for name in names))
            for method in METHODS.values()
            if method.native
        ),
    )


def deployment_features() -> Table:
    """Return what each tier supports and keeps of each method of the paper."""
    rows = [
        Row((method.title,), tuple(_kept(method, tier, name) for tier in _SHOWN for name in _SHOWN[tier]))
        for method in METHODS.values()
        if method.paper_name or method.retained
    ]
    return Table(
        "feature_mapping",
        "What each tier keeps. Fallback: opaque, static colours. Method-aware: the functions listed.",
        ("Method",),
        tuple(Column(_title(name), (TIER_TITLES[tier],)) for tier in _SHOWN for name in _SHOWN[tier]),
        tuple(rows),
        (f"{NOT_THERE}: the representation has no such thing", f"{NOT_SUPPORTED}: not supported"),
    )


def _kept(method: Method, tier: Tier, name: str) -> Cell:
    kept = method.retained.get(tier)
    if kept is None:
        return Cell(
            NOT_SUPPORTED,
            reason=f"{method.title}: {method.unsupported.get(tier, 'it does not say what it keeps')}",
        )
    return _cell(getattr(kept, name), (kept.notes[name],) if name in kept.notes else ())


def _cell(value: bool | str | None, notes: tuple[str, ...] = ()) -> Cell:
    if value is None:
        return Cell(NOT_THERE)
    return Cell({True: "yes", False: "no"}[value] if isinstance(value, bool) else value, value, notes=notes)


def _title(name: str) -> str:
    return _TITLES.get(name, name.replace("_", " ").capitalize())
