"""How the parts of the reader refuse a file: they know what is wrong and where, but not in which file."""

from __future__ import annotations

from typing import Any


class Refusal(Exception):
    """A reason to refuse the file; `read_checkpoint` makes a `CheckpointError` of it.

    Parameters
    ----------
    code, message : str
        The code and the message of the `CheckpointError`.
    at : str, optional
        The place in the file: "byte 12", or "data.pkl byte 12".
    value, limit : optional
        What was found and what is allowed.
    """

    def __init__(
        self, code: str, message: str, *, at: str | None = None, value: Any = None, limit: Any = None
    ) -> None:
        super().__init__(code, message)
        self.code, self.message = code, message
        self.at, self.value, self.limit = at, value, limit
