"""What a record holds of the tasks that were tried on a mesh."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from msb.bench.strict import Amount, Name, Record


class TriedTask(Record):
    """What became of one task that was tried on the mesh (`msb.trial.run.Trial`).

    `picture` is the name of a file in the folder "trial" beside the record.
    """

    task: Name
    title: str
    outcome: Literal["works", "care", "fails", "not_run"]
    why: str | None
    seconds: Amount
    says: str = ""
    numbers: dict[str, Any] = {}
    libraries: dict[str, str] = {}
    files: tuple[str, ...] = ()
    picture: str | None = None


class Tried(Record):
    """The document of `msb trial --json`."""

    schema_: Literal["msb.trial/1"] = Field(default="msb.trial/1", alias="schema")
    path: str | None
    trials: tuple[TriedTask, ...]
    mesh: dict[str, Any]
    limits: dict[str, float | None]
    cameras: dict[str, Any]
