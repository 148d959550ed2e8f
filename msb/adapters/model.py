"""The class that every adapter returns: a trained model in the asset's terms."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Description
    from msb.asset.manifest import Domain
    from msb.errors import Finding


@dataclass(frozen=True, eq=False)
class Model:
    """A trained model: arrays, what they belong to, and what the manifest says of them.

    Attributes
    ----------
    buffers : dict of str to ndarray
        Arrays by the asset's names; views on the mapped file, not copies, where the file's layout allows
        that.
    domains : dict of str to {"vertex", "face", "corner", "global"}
        The domain of every buffer but `positions` and `indices`.
    description : Description
        Method, kernels and settings; its `source` is filled in by `export`.
    root : Path
        The output folder of the training, or the folder of the single file.
    files : tuple of Path
        All files that were read, the one with the model first.
    warnings : tuple of Finding
        What was missing or odd, and what was done instead.
    """

    buffers: dict[str, NDArray[Any]]
    domains: dict[str, Domain]
    description: Description
    root: Path
    files: tuple[Path, ...]
    warnings: tuple[Finding, ...] = field(default=())
