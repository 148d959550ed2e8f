"""What became of the tasks that were tried on an asset's mesh, as its page shows it."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from msb.base.files import read_file
from msb.errors import shorten

if TYPE_CHECKING:
    from msb.report.results import Loaded

FOLDER = "trial"
"""The folder beside a record with the pictures of its trials."""
_MARKS: Mapping[str, Literal["YES", "WITH CARE", "NO", "UNKNOWN"]] = {
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

    mark: Literal["YES", "WITH CARE", "NO", "UNKNOWN"]
    task: str
    title: str
    why: str
    picture: str | None = None

    def to_dict(self) -> dict[str, str]:
        """Return it as JSON data, without the picture."""
        return {"mark": self.mark, "task": self.task, "why": self.why}


def problem(document: Any) -> str | None:
    """Return where a record's trials are not what `msb trial` writes, None if they are."""
    trials = document.get("trials") if isinstance(document, dict) else None
    if not isinstance(trials, list):
        return "/trial/trials"
    for number, one in enumerate(trials):
        if not isinstance(one, dict) or str(one.get("outcome")) not in _MARKS:
            return f"/trial/trials/{number}/outcome"
        for key in ("task", "title", "says", "why", "picture"):
            if not isinstance(one.get(key, 0), str | (type(None) if key in ("why", "picture") else str)):
                return f"/trial/trials/{number}/{key}"
        if not isinstance(one.get("seconds"), int | float):
            return f"/trial/trials/{number}/seconds"
    return None


def tried_tasks(loaded: Loaded | None, *, pictures: bool = True) -> list[TriedTask]:
    """Return the tasks on record; none where none was tried.

    Parameters
    ----------
    loaded : Loaded, optional
        The record of the exported mesh, whose trials `problem` found nothing wrong with.
    pictures : bool
        Whether pictures are read, which the page shows.
    """
    if loaded is None or loaded.result.trial is None:
        return []
    found = []
    for one in loaded.result.trial["trials"]:
        spent = "" if one["outcome"] == "not_run" else f" ({one['seconds']:.1f} s)"
        said = "; ".join(filter(None, (one["says"], one["why"])))
        why = f"{shorten(said[:1].upper() + said[1:], 500)}{spent}."
        picture = png_uri(loaded, FOLDER, one["picture"]) if pictures else None
        found.append(TriedTask(_MARKS[one["outcome"]], one["task"], one["title"], why, picture))
    return found


def png_uri(loaded: Loaded, folder: str, name: str | None) -> str | None:
    """Return the picture `name` in a folder beside a record as an address; None if it is none."""
    path = None if name is None else loaded.file(f"{folder}/{name}")
    if path is None:
        return None
    data = read_file(path, _MOST_BYTES)
    if not data.startswith(_PNG) or len(data) > _MOST_BYTES:
        return None
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"
