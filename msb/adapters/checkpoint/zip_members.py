"""What a torch archive may hold, for the strict reader of ZIP files.

Such an archive differs from a packed `.triasset`: sizes and checksum also come behind the data (bit 3 of the
flags), the end record always has a ZIP64 twin, and the local header's extra field is filled up so that data
starts on a 64-byte boundary. Source: pytorch/pytorch `caffe2/serialize/inline_container.cc`.
"""

from __future__ import annotations

from typing import NoReturn

from msb.adapters.checkpoint.refusal import Refusal
from msb.asset import strict_zip
from msb.asset.strict_zip import Member, Policy
from msb.errors import shorten

MAX_MEMBERS = 20_000
"""Most members. There is one per tensor and a handful more: the methods' files have below 30, large models
thousands."""
MAX_NAME = 500


def is_script(name: str) -> bool:
    """Return whether a member belongs to a TorchScript program: its constants or source code."""
    return name.endswith("/constants.pkl") or "/code/" in name


def refuse_script(name: str) -> NoReturn:
    """Raise the error that the archive is a program."""
    text = f"it holds a TorchScript program ({shorten(name, 40)}); a saved state is needed"
    raise Refusal("CHECKPOINT_NOT_RECOGNISED", text)


class _Torch(Policy):
    max_members = MAX_MEMBERS
    descriptors = True

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        raise Refusal(f"CHECKPOINT_{code}", message, at=f"byte {at}")

    def name(self, raw: bytes, flags: int, at: int) -> str:
        try:
            name = raw.decode()
        except UnicodeDecodeError:
            name = ""
        if not name or len(name) > MAX_NAME or not name.isprintable():
            self.refuse("FORM", "a member's name is empty, too long or not printable UTF-8", at)
        return name

    def compressed(self, name: str, method: int, at: int) -> NoReturn:
        """Refuse a compressed member; for source code, which torch compresses, say that it is a program."""
        if is_script(name):
            refuse_script(name)
        super().compressed(name, method, at)


def read_members(view: memoryview) -> dict[str, Member]:
    """Return the members of the archive by name, in file order."""
    return strict_zip.read_members(view, _Torch())
