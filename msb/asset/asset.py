"""The class `Asset`: a manifest and its buffers.

The methods of `Asset` call functions of `msb` that other packages implement. These methods import `msb`
when they are called.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.manifest import Manifest
from msb.base.origin import to_world
from msb.errors import Finding, one_line
from msb.registry import Tier, lookup

if TYPE_CHECKING:
    import msb


@dataclass(frozen=True, repr=False, eq=False)
class Asset:
    """An asset: a manifest and its buffers.

    Attributes
    ----------
    manifest : Manifest
        The keys of the manifest as attributes.
    buffers : mapping of str to ndarray
        Read-only arrays of the declared shape and dtype. In a loaded asset, buffers are views of the
        memory-mapped file.
    path : Path or None
        The `.triasset` of the buffers. The value is None if the asset was built in memory.
    warnings : tuple of Finding
        Problems that `load` reported as warnings.
    opened_from : Path or None
        The `.triasset`, checkpoint or mesh file that was opened. The training cameras are searched for in
        the folder of this file. The manifest does not contain this path.

    Notes
    -----
    `load` does not read the values. Check the values before computing with them. The memory mapping exists as
    long as an array refers to it. If another program truncates the file, reading the missing part ends this
    process, as with any memory mapping.

    `copy.copy` shares the arrays and the mapping. `copy.deepcopy` and `pickle` copy the values, so that the
    copy does not need the file. To pass an asset to another process on the same machine, send its path.
    A copy of the asset keeps the value of `path`.

    Examples
    --------
    >>> import msb
    >>> asset = msb.open("data_stubs/checkpoint")
    >>> asset.vertices.shape, asset.faces.shape, asset.colors.shape
    ((2582, 3), (5159, 3), (2582, 3))
    >>> asset.audit().verdict, asset.repair(["orient", "pair"]).after.verdict
    ('bad', 'limited')
    """

    manifest: Manifest
    buffers: Mapping[str, NDArray[Any]]
    path: Path | None = None
    warnings: tuple[Finding, ...] = ()
    opened_from: Path | None = None
    _known: dict[str, str] = field(default_factory=dict, init=False)
    """Results that `repr` shows, such as the verdict of an audit."""

    @property
    def vertices(self) -> NDArray[np.float64]:
        """The coordinates (V, 3) in the scene as a new array: the buffer `positions` plus the `origin`.

        The buffer is float32. The origin in the manifest is (0, 0, 0), unless the mesh is very far from
        zero relative to its size (docs/triasset.md).
        """
        return to_world(self.buffers["positions"].astype(np.float64), self.manifest.origin)

    @property
    def faces(self) -> NDArray[np.int64]:
        """The vertex indices (F, 3) of all stored faces as a new array. Indices start at 0."""
        return self.buffers["indices"].astype(np.int64)

    @property
    def colors(self) -> NDArray[np.float32] | None:
        """The static sRGB colours of the standard tier (opaque rendering) in [0, 1] as a new array, or None.

        The shape is (V, 3) or (V, 4) if the model stores colours by vertex, (F, 3) or (F, 4) by face, and
        (3F, 3) or (3F, 4) by face corner. ``asset.manifest.buffers["color"].domain`` states the domain. For a
        model with spherical harmonics, the colour comes from the coefficients of degree 0 in the buffer
        ``"f_dc"``. A fourth channel is alpha, which renderers ignore. The result does not include textures.
        Textures are the buffers ``texture.0``, ``texture.1`` and so on. Renderers multiply textures by these
        colours.
        """
        from msb.asset.look import tint_of

        found = tint_of(self)
        if found is None:
            return None
        scale = np.float32(255 if found.values.dtype == np.uint8 else 1)
        return found.values.astype(np.float32) / scale

    def audit(self, **options: Any) -> msb.Audit:
        """Audit the mesh exactly as it is stored. The options are the options of `msb.audit`."""
        import msb

        return msb.audit(self, **options)

    def repair(self, plan: Sequence[str] | str | None = None, **options: Any) -> msb.Repaired:
        """Return a repaired copy and a report. `msb.repair` describes plan and options."""
        import msb

        return msb.repair(self, plan, **options)

    def bake(self, **options: Any) -> msb.Baked:
        """Return an opaque mesh that looks like the model, with a report of its quality. See `msb.bake`."""
        import msb

        return msb.bake(self, **options)

    def render(self, camera: msb.Camera, tier: Tier = "standard", **options: Any) -> msb.Frame:
        """Render an image from one camera. `msb.render` describes tiers and options."""
        import msb

        return msb.render(self, camera, tier, **options)

    def save(self, path: str | os.PathLike[str], **options: Any) -> None:
        """Write the asset in the format of the suffix of `path`.

        The options are the options of `msb.save`.
        """
        import msb

        msb.save(self, path, **options)

    def __reduce__(self) -> tuple[Any, ...]:
        # A mappingproxy cannot be pickled or copied, and unpickled arrays are always writable.
        return _restored, (self.manifest, dict(self.buffers), self.path, self.warnings, self.opened_from)

    def __repr__(self) -> str:
        name, facts = self.manifest.method, self._facts()
        words = [facts.pop("Faces") + " faces", facts.pop("Vertices") + " vertices", facts.pop("Topology")]
        return one_line(f"<Asset {name}: {', '.join([*words, *facts.values()])}>")

    def _repr_html_(self) -> str:
        """Return an HTML table that notebooks display."""
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
    """Return an asset with the given attributes and read-only buffers."""
    views = {name: array.view() for name, array in buffers.items()}
    for view in views.values():
        view.flags.writeable = False
    return Asset(manifest, MappingProxyType(views), *others)
