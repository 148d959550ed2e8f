"""The packed form: a ZIP of stored members, each starting on a 64-byte boundary, mapped as a whole.

It is the strict subset of ZIP that `docs/triasset.md` describes and `msb.asset.strict_zip` reads.
"""

from __future__ import annotations

import stat
from typing import Any, NoReturn

from msb.asset.manifest import ALIGNMENT, MANIFEST_NAME
from msb.asset.paths import is_member_name
from msb.asset.strict_zip import UTF8, Member, Policy, read_members
from msb.errors import AssetError, shorten

_MAX_EXTRA = 128
"""Padding to 64 bytes and one ZIP64 record need fewer bytes than this; a longer field could hide data."""
_DOS_FOLDER = 0x10


class _Packed(Policy):
    """What a packed asset may hold; `file` is named in errors."""

    max_members = 65
    """manifest.json and the 64 buffers a manifest can declare."""

    def __init__(self, file: object) -> None:
        self.file = file

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        pointer = f"byte {at}"
        raise AssetError(f"TRIASSET_{code}", message, file=self.file, pointer=pointer)

    def name(self, raw: bytes, flags: int, at: int) -> str:
        text = raw.decode("utf-8" if flags & UTF8 else "cp437", "replace")
        if not is_member_name(text) or text.encode() != raw:
            message = f'the member "{shorten(text)}" is neither {MANIFEST_NAME} nor buffers/NAME.bin'
            self.refuse("FORM", message, at)
        return text

    def same_name(self, name: str) -> str:
        return name.casefold()

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        """Refuse what some extractor would make a link, folder or device of, whatever system wrote it."""
        if extra > _MAX_EXTRA:
            self.refuse("DAMAGED", f"{name} has {extra} bytes of extra data", at)
        kind = stat.S_IFMT(attributes >> 16)
        if kind == stat.S_IFLNK:
            self.refuse("PATH", f"{name} is a symbolic link", at)
        if kind not in (0, stat.S_IFREG) or attributes & _DOS_FOLDER:
            self.refuse("PATH", f"{name} is marked as a folder or device", at)

    def check_place(self, name: str, start: int, extra: int) -> None:
        if extra > _MAX_EXTRA:
            text = f"{name} has {extra} bytes of extra data"
            self.refuse("HOSTILE", text, start - extra)
        if start % ALIGNMENT:
            text = f"{name} starts at byte {start}; it must be a multiple of {ALIGNMENT}"
            self.refuse("FORM", text, start)


def parse_packed(data: Any, *, file: object) -> dict[str, Member]:
    """Return the members of a packed asset by name, in file order; `file` is named in errors."""
    return read_members(data, _Packed(file))
