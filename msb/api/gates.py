"""`--fail-on`, `--profile` and `--fail-on-verdict`: audit results that make a command fail."""

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
# For each purpose, the conditions under which a mesh is unfit. We chose the limits of `game` and `print`.
PROFILES: dict[Profile, tuple[str, ...]] = {
    # For engines. Simplification, subdivision and UV unwrapping need connected faces. A closed mesh has V/F =
    # 0.5, and a triangle soup has V/F = 3. Props (game objects) may consist of pieces. Engines duplicate
    # vertices at non-manifold elements. Up to 1 % of non-manifold elements can be repaired by a tool or by
    # hand. Open edges are harmless in game engines.
    "game": (
        "nonfinite_faces>0",
        "vf_ratio>2.5",
        "nonmanifold_edge_ratio>0.01",
        "nonmanifold_vertex_ratio>0.01",
        "inconsistent_winding_edges>0",
    ),
    # The profile `print`, for slicers: a closed, consistently wound surface, which may consist of several
    # bodies.
    "print": (
        "nonfinite_faces>0",
        "boundary_edges>0",
        "nonmanifold_edges>0",
        "nonmanifold_vertices>0",
        "inconsistent_winding_edges>0",
        "duplicate_faces>0",
        "repeated_index_faces>0",
    ),
    # The mesh must be at least as connected as the paper's average of MeshSplatting (Table
    # mesh_connectivity).
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
    """The audit results that make a command fail."""

    fail_on: Annotated[
        tuple[str, ...],
        Option('Fail if this condition is true, e.g. "components>1". May be given again.', metavar="COND"),
    ] = ()
    fail_on_verdict: Annotated[
        FailingLevel | None, Option("Fail if the verdict has this level or a worse level.")
    ] = None
    profile: Annotated[
        Profile | None,
        Option("Fail unless the mesh is fit for this purpose; docs/cli.md lists the conditions."),
    ] = None

    def gates(self) -> list[Gate | VerdictGate]:
        """Return the requested gates (conditions that make the command fail)."""
        gates: list[Gate | VerdictGate] = [*map(parse_gate, self.fail_on)]
        if self.profile is not None:
            gates += [replace(parse_gate(text), profile=self.profile) for text in PROFILES[self.profile]]
        return gates if self.fail_on_verdict is None else [*gates, VerdictGate(self.fail_on_verdict)]


@dataclass(frozen=True)
class Gate:
    """A gate (condition) that fails if ``key operator limit`` is true."""

    key: str
    sign: str
    limit: float
    profile: Profile | None = None

    def check(self, audit: Audit, path: Path) -> GateFailed | None:
        """Return an error if the condition is true for `audit`.

        A profile checks the mesh after the requested weld. Without a weld, seams are merged. A ratio with the
        denominator 0 fails as well, because an empty mesh must not pass.
        """
        judged = audit if self.profile is None else audit.welded or audit.judged
        value = {**asdict(judged.counts), **asdict(judged.metrics)}[self.key]
        of = f" of profile {self.profile}" if self.profile else ""
        condition = f"gate{of}: {self.key} {self.sign} {self.limit:g}"
        if value is not None and not _OPERATORS[self.sign](value, self.limit):
            return None
        text = "is undefined for this mesh (its denominator is 0)" if value is None else f"is {value:g}"
        return GateFailed("GATE_FAILED", f"{self.key} {text}, {condition}", file=path)


@dataclass(frozen=True)
class VerdictGate:
    """A gate (condition) that fails if the verdict is `level` or worse."""

    level: FailingLevel

    def check(self, audit: Audit, path: Path) -> GateFailed | None:
        """If the verdict is `level` or worse, return the error with the reason of the verdict."""
        from msb.topology.verdict import judge

        verdict = judge(audit)
        if verdict.level not in _FAILING[self.level]:
            return None
        text = f"verdict is {verdict.word} ({verdict.reason}), gate: {' or '.join(_FAILING[self.level])}"
        return GateFailed("GATE_FAILED", text, file=path)


def parse_gate(text: str) -> Gate:
    """Return the gate for a text ``KEY OPERATOR NUMBER``, such as "nonmanifold_edge_ratio>0"."""
    from msb.topology.audit import Metrics
    from msb.topology.findings import Counts

    match = _PATTERN.fullmatch(text)
    if not match:
        problem = f'--fail-on "{shorten(text)}" is not KEY OPERATOR NUMBER, such as "components>1"'
        raise UsageError("USAGE", problem)
    key, sign, number = match.groups()
    keys = [field.name for kind in (Counts, Metrics) for field in fields(kind)]
    if key not in keys:
        near = difflib.get_close_matches(key, keys, 3, 0.6)
        hint = (
            f"did you mean {' or '.join(near)}?"
            if near
            else "msb audit --json lists the keys under counts and metrics"
        )
        raise UsageError("USAGE", f'--fail-on: the key "{shorten(key)}" is unknown; {hint}')
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise UsageError("USAGE", f'--fail-on: "{shorten(number)}" is not a finite number')
    return Gate(key, sign, limit)
