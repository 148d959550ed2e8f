"""`--fail-on`, `--profile` and `--fail-on-verdict`: conditions on an audit that make the command fail."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msb.base.option import Option
from msb.errors import GateFailed, UsageError, shorten

if TYPE_CHECKING:
    from msb.topology.audit import Audit
    from msb.topology.verdict import Level

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_PATTERN = re.compile(r"\s*(?:(?:counts|metrics)\.)?([a-z_]+)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*")

FailingLevel = Literal["limited", "bad"]
_FAILING: dict[FailingLevel, tuple[Level, ...]] = {"limited": ("limited", "bad"), "bad": ("bad",)}
Profile = Literal["game", "print", "research"]
# Purpose of a mesh -> conditions under which it is not fit. The limits are ours, but for `research`.
PROFILES: dict[Profile, tuple[str, ...]] = {
    # What runs in an engine: real-time simplification, subdivision and UV unwrapping walk from face to face
    # and copy vertices where they cannot; one element in a hundred is mended by hand or by a tool.
    # Open edges are harmless there. V/F of a closed mesh is 1/2, of a soup 3.
    "game": (
        "nonfinite_faces>0",
        "vf_ratio>2.5",
        "nonmanifold_edge_ratio>0.01",
        "nonmanifold_vertex_ratio>0.01",
        "inconsistent_winding_edges>0",
        "lcc_face_ratio<0.5",
    ),
    # What a slicer fills: a closed, consistently wound surface; several bodies may stand beside each other.
    "print": (
        "nonfinite_faces>0",
        "boundary_edges>0",
        "nonmanifold_edges>0",
        "nonmanifold_vertices>0",
        "inconsistent_winding_edges>0",
        "duplicate_faces>0",
        "repeated_index_faces>0",
    ),
    # No worse connected than MeshSplatting in the mean of the paper's scenes (Table mesh_connectivity).
    "research": (
        "nonfinite_faces>0",
        "boundary_edge_ratio>0.45",
        "nonmanifold_edge_ratio>0.18",
        "nonmanifold_vertex_ratio>0.65",
        "lcc_face_ratio<0.7",
        "lcc_area_ratio<0.69",
    ),
}


@dataclass(frozen=True)
class GateOptions:
    """What makes a command fail that audits a mesh."""

    fail_on: Annotated[
        tuple[str, ...], Option('Fail if e.g. "components>1" holds. May be given again.', metavar="COND")
    ] = ()
    fail_on_verdict: Annotated[FailingLevel | None, Option("Fail if the verdict is this or worse.")] = None
    profile: Annotated[
        Profile | None, Option("Fail unless the mesh is fit for this; docs/cli.md has the conditions.")
    ] = None

    def gates(self) -> list[Gate | VerdictGate]:
        """Return the gates that are asked for."""
        gates: list[Gate | VerdictGate] = [*map(parse_gate, self.fail_on)]
        if self.profile is not None:
            gates += [replace(parse_gate(text), profile=self.profile) for text in PROFILES[self.profile]]
        return gates if self.fail_on_verdict is None else [*gates, VerdictGate(self.fail_on_verdict)]


@dataclass(frozen=True)
class Gate:
    """The command fails if ``key operator limit`` holds."""

    key: str
    sign: str
    limit: float
    profile: Profile | None = None

    def check(self, audit: Audit, path: Path) -> GateFailed | None:
        """Return the failure if the gate's condition holds for `audit`; of a profile, for it without seams.

        A value that does not exist (a ratio over nothing) fails too: an empty mesh must not pass a gate
        because there was nothing to measure.
        """
        judged = audit if self.profile is None else audit.judged
        value = {**asdict(judged.counts), **asdict(judged.metrics)}[self.key]
        of = f" of profile {self.profile}" if self.profile else ""
        condition = f"gate{of}: {self.key} {self.sign} {self.limit:g}"
        if value is not None and not _OPERATORS[self.sign](value, self.limit):
            return None
        text = "does not exist for this mesh (a ratio over nothing)" if value is None else f"is {value:g}"
        return GateFailed("GATE_FAILED", f"{self.key} {text}, {condition}", file=path)


@dataclass(frozen=True)
class VerdictGate:
    """The command fails if the verdict is `level` or worse."""

    level: FailingLevel

    def check(self, audit: Audit, path: Path) -> GateFailed | None:
        """Return the failure if the verdict on `audit` is this bad, with its first reason."""
        from msb.topology.verdict import judge

        verdict = judge(audit)
        if verdict.level not in _FAILING[self.level]:
            return None
        text = f"verdict is {verdict.word} ({verdict.reason}), gate: {' or '.join(_FAILING[self.level])}"
        return GateFailed("GATE_FAILED", text, file=path)


def parse_gate(text: str) -> Gate:
    """Return the gate written as ``KEY OPERATOR NUMBER``, such as "nonmanifold_edge_ratio>0"."""
    from msb.topology.audit import Metrics
    from msb.topology.findings import Counts

    match = _PATTERN.fullmatch(text)
    if not match:
        shown = shorten(text)
        raise UsageError("USAGE", f'--fail-on "{shown}" is not KEY OPERATOR NUMBER, such as "components>1"')
    key, sign, number = match.groups()
    keys = [field.name for kind in (Counts, Metrics) for field in fields(kind)]
    if key not in keys:
        near = difflib.get_close_matches(key, keys, 3, 0.6)
        hint = (
            f"did you mean {' or '.join(near)}?"
            if near
            else "msb audit --json has them in counts and metrics"
        )
        raise UsageError("USAGE", f'--fail-on: there is no key "{shorten(key)}"; {hint}')
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise UsageError("USAGE", f'--fail-on: "{shorten(number)}" is not a finite number')
    return Gate(key, sign, limit)
