"""How the parts of the reader refuse a file: they know what is wrong and where, but not in which file."""

from __future__ import annotations


class Refusal(Exception):
    """A reason to refuse the file; `read_checkpoint` makes a `CheckpointError` of it.

    Parameters
    ----------
    code, message : str
        The code and the message of the `CheckpointError`.
    at : str, optional
        The place in the file: "byte 12", or "data.pkl byte 12".
    """

    def __init__(self, code: str, message: str, *, at: str | None = None) -> None:
        super().__init__(code, message)
        self.code, self.message = code, message
        self.at = at


class Unfinished(Refusal):
    """The pickle goes on behind the bytes there are."""
