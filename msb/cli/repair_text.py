"""What `msb repair` says of a repair: as JSON, as notes and as text."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.paths import shell_word

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.repair.assets import Repaired
    from msb.repair.run import Outcome
    from msb.topology import Audit

SCHEMA = "msb.repair/1"


def document(
    source: Path, target: Path, plan: tuple[str, ...], done: Repaired | Outcome, left: list[str]
) -> dict[str, Any]:
    """Return the JSON data of a repair, `msb.repair/1`."""
    before, after = done.before.to_dict(), done.after.to_dict()
    return {
        "schema": SCHEMA,
        "path": str(source),
        "output": str(target),
        "plan": list(plan),
        "steps": [step.to_dict() for step in done.steps],
        "edges_cut": len(done.cut_edges),
        "faces_turned": int(done.turned.sum()),
        "left": left,
        "before": {key: before[key] for key in ("counts", "metrics")},
        "after": {key: after[key] for key in ("counts", "metrics")},
        "verdict_before": before["verdict"],
        "verdict_after": after["verdict"],
    }


def advice(audit: Audit, output: str, source: str) -> str | None:
    """Return what helps where faces share no vertices; `output` is the option -o, `source` what to repair."""
    from msb.registry import lookup

    if audit.closed_once_merged or audit.corners_coincide:
        return f"Merge the vertices: msb repair --plan weld,orient,pair {output} {source}"
    if audit.corners_coincide is False and audit.method and "dedicated" in lookup(audit.method).passes:
        shown = f"msb web --tier dedicated -o page.html {source}"
        return (
            f"As trained it is seen on the dedicated tier alone: {shown}; what engines lose: msb why {source}"
        )
    return None


def note_turned(asset: Asset, done: Repaired, output: Output) -> None:
    """Say what turned faces change where back faces are culled."""
    turned = int(done.turned.sum())
    if turned == 0:
        return
    stored = asset.manifest.settings.get("back_culling")
    text = (
        f"{turned:,} of {len(done.turned):,} faces were turned: where back faces are culled they show from "
    )
    text += "the other side"
    if stored is not None and stored.value:
        text += "; this asset has back_culling on"
    output.note(text)


def print_repair(
    source: Path, target: Path, done: Repaired | Outcome, left: list[str], pieces: int | None, output: Output
) -> None:
    """Print the verdict on the result; unless quiet its steps, what is left and what comes next, too.

    `pieces` are the components of the repaired mesh, where the file's format split them further.
    """
    from rich.markup import escape

    from msb.cli.output import plain_table
    from msb.errors import one_line
    from msb.topology.verdict import judge

    console = output.console()
    verdicts = [judge(audit).word for audit in (done.before, done.after)]
    names = [escape(one_line(str(path))) for path in (source, target)]
    console.print(f"[bold]{names[1]}[/bold]: {verdicts[1]}; {names[0]} was {verdicts[0]}", soft_wrap=True)
    if output.quiet:
        return
    headers = ("Step", "Faces removed", "added", "turned", "Vertices removed", "added", "Seconds")
    table = plain_table(*headers, right=tuple(range(1, len(headers))))
    for step in done.steps:
        numbers = [getattr(step, f.name) for f in fields(step)[1:6]]
        table.add_row(step.step, *(f"{number:,}" for number in numbers), f"{step.seconds:.2f}")
    console.print(table)
    for note in dict.fromkeys(note for step in done.steps for note in step.notes):
        console.print(escape(one_line(note)), soft_wrap=True)
    before, after = done.before.counts.components, done.after.counts.components
    text = f"{after:,} after" if pieces is None else f"{pieces:,} after, {after:,} in the file"
    cut = f"edges cut{'' if pieces is None else ' by the repair'}: {len(done.cut_edges):,}"
    console.print(f"Components: {before:,} before, {text}; {cut}", soft_wrap=True)
    console.print(f"Left: {'; '.join(left) or 'nothing'}", soft_wrap=True)
    words = [escape(shell_word(one_line(str(path)))) for path in (source, target)]
    helps = advice(done.before, f"--force -o {words[1]}", words[0])
    if helps and all(step.step != "weld" for step in done.steps):
        console.print(helps, soft_wrap=True)
    console.print(f"next: msb view {words[0]} --repaired {words[1]}", soft_wrap=True)
