"""What every verb is about: a manifest and its buffers.

The verbs stand in rooms above this one. They are methods here all the same, which import `msb` when they are
called: the one place where the ground looks up.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from msb.asset.manifest import Manifest
from msb.errors import Finding, one_line
from msb.registry import Tier, lookup

if TYPE_CHECKING:
    import msb


@dataclass(frozen=True, repr=False, eq=False)
class Asset:
    """A manifest and its buffers.

    Attributes
    ----------
    manifest : Manifest
        The manifest's keys as attributes.
    buffers : mapping of str to ndarray
        Read-only arrays of the declared shape and dtype. Those of a loaded asset are views of the mapped
        file.
    path : Path or None
        The `.triasset` that the buffers are in; None if the asset was built in memory.
    warnings : tuple of Finding
        What `load` noticed and tolerated.
    opened_from : Path or None
        What it was opened from: a `.triasset`, a checkpoint or a mesh file, beside which the cameras of its
        training are looked for. It is in no manifest.

    Notes
    -----
    `load` does not read the values, so code that computes with them must check them first. The mapping lives
    as long as an array refers to it. If another program shortens the file meanwhile, touching the lost pages
    ends the process, as with any memory mapping.

    `copy.copy` shares the arrays and so the mapping. `copy.deepcopy` and `pickle` copy the values: such a
    copy needs no file, and as much memory as its buffers have bytes. To a process on the same machine it is
    better to send the path. `path` stays the same in a copy.

    Examples
    --------
    >>> import msb
    >>> asset = msb.open("data_stubs/checkpoint")
    >>> asset.audit().verdict, asset.repair(["orient", "pair"]).after.verdict
    ('bad', 'limited')
    """

    manifest: Manifest
    buffers: Mapping[str, NDArray[Any]]
    path: Path | None = None
    warnings: tuple[Finding, ...] = ()
    opened_from: Path | None = None
    _known: dict[str, str] = field(default_factory=dict, init=False)
    """What a verb found out, which is shown: the verdict of an audit."""

    def audit(self, **options: Any) -> msb.Audit:
        """Audit the mesh exactly as it is stored: `msb.audit`, which describes the options."""
        import msb

        return msb.audit(self, **options)

    def repair(self, plan: Sequence[str] | str | None = None, **options: Any) -> msb.Repaired:
        """Return a repaired copy, and what was done: `msb.repair`, which describes plan and options."""
        import msb

        return msb.repair(self, plan, **options)

    def bake(self, **options: Any) -> msb.Baked:
        """Return a plain asset that looks like it, and what that lost: `msb.bake` describes the options."""
        import msb

        return msb.bake(self, **options)

    def render(self, camera: msb.Camera, tier: Tier = "standard", **options: Any) -> msb.Frame:
        """Draw it once, as one camera sees it: `msb.render`, which describes tiers and options."""
        import msb

        return msb.render(self, camera, tier, **options)

    def save(self, path: str | os.PathLike[str], **options: Any) -> None:
        """Write it in the format that the suffix of `path` names: `msb.save`, which describes the options."""
        import msb

        msb.save(self, path, **options)

    def __reduce__(self) -> tuple[Any, ...]:
        # A mappingproxy is neither pickled nor copied, and arrays come back writable.
        return _restored, (self.manifest, dict(self.buffers), self.path, self.warnings, self.opened_from)

    def __repr__(self) -> str:
        name, facts = self.manifest.method, self._facts()
        words = [facts.pop("Faces") + " faces", facts.pop("Vertices") + " vertices", facts.pop("Topology")]
        return one_line(f"<Asset {name}: {', '.join([*words, *facts.values()])}>")

    def _repr_html_(self) -> str:
        """Return a table, which notebooks show."""
        facts = {"Method": lookup(self.manifest.method).title, **self._facts()}
        rows = (f"<tr><th>{name}</th><td>{escape(one_line(text))}</td></tr>" for name, text in facts.items())
        return f"<table>{''.join(rows)}</table>"

    def _facts(self) -> dict[str, str]:
        m = self.manifest
        return {
            "Faces": f"{m.face_count:,}",
            "Vertices": f"{m.vertex_count:,}",
            "Topology": m.topology.replace("_", " "),
            "Size": f"{sum(spec.byte_length for spec in m.buffers.values()):,} bytes",
            **self._known,
            "From": "in memory" if self.opened_from is None else str(self.opened_from),
        }


def _restored(manifest: Manifest, buffers: dict[str, NDArray[Any]], *others: Any) -> Asset:
    """Return the asset of these parts, its buffers read-only."""
    views = {name: array.view() for name, array in buffers.items()}
    for view in views.values():
        view.flags.writeable = False
    return Asset(manifest, MappingProxyType(views), *others)
