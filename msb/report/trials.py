"""What became of the tasks that were tried on an asset's mesh, as its page shows it."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from msb.base.files import read_file
from msb.errors import shorten

if TYPE_CHECKING:
    from msb.report.results import Loaded

FOLDER = "trial"
"""The folder beside a record with the pictures of its trials."""
Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN"]
_MARKS: dict[str, Mark] = {
    "works": "YES",
    "care": "WITH CARE",
    "fails": "NO",
    "not_run": "UNKNOWN",
}
_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_BYTES = 4 << 20


@dataclass(frozen=True)
class TriedTask:
    """One task: its mark, its name, what was made and what is wrong with it, and its picture."""

    mark: Mark
    task: str
    title: str
    why: str
    picture: str | None = None

    def to_dict(self) -> dict[str, str]:
        """Return it as JSON data, without the picture."""
        return {"mark": self.mark, "task": self.task, "why": self.why}


def tried_tasks(loaded: Loaded | None, *, pictures: bool = True) -> list[TriedTask]:
    """Return the tasks in the record of an exported mesh; `pictures` are for the page."""
    if loaded is None or loaded.result.trial is None:
        return []
    tasks = []
    for trial in loaded.result.trial.trials:
        spent = "" if trial.outcome == "not_run" else f" ({trial.seconds:.1f} s)"
        said = "; ".join(filter(None, (trial.says, trial.why)))
        why = f"{shorten(said[:1].upper() + said[1:], 500)}{spent}."
        picture = png_uri(loaded, FOLDER, trial.picture) if pictures else None
        tasks.append(TriedTask(_MARKS[trial.outcome], trial.task, trial.title, why, picture))
    return tasks


def png_uri(loaded: Loaded, folder: str, name: str | None) -> str | None:
    """Return the picture `name` in a folder beside a record as an address; None if it is none."""
    path = None if name is None else loaded.file(f"{folder}/{name}")
    if path is None:
        return None
    data = read_file(path, _MOST_BYTES)
    if not data.startswith(_PNG) or len(data) > _MOST_BYTES:
        return None
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"
