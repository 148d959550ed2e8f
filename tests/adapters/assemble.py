"""Build invalid checkpoints from single instructions of a pickle."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tests.corpus.forge import Entry, forge

MAGIC = b"\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19"
VALUES = struct.pack("<6f", 1, 2, 3, 4, 5, 6)


@dataclass(frozen=True)
class Case:
    """A bad checkpoint: its name, its error code, and a function that returns its bytes."""

    name: str
    code: str
    make: Callable[[], bytes]


# --- instructions


def text(value: str | bytes) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return b"X" + struct.pack("<I", len(raw)) + raw


def short_text(value: str) -> bytes:
    raw = value.encode()
    return b"\x8c" + bytes([len(raw)]) + raw


def integer(value: int) -> bytes:
    if 0 <= value < 256:
        return b"K" + bytes([value])
    if -(1 << 31) <= value < 1 << 31:
        return b"J" + struct.pack("<i", value)
    raw = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
    return b"\x8a" + bytes([len(raw)]) + raw


def name(module: str, what: str) -> bytes:
    return b"c" + module.encode() + b"\n" + what.encode() + b"\n"


def row(*items: bytes) -> bytes:
    """Return the instructions for a tuple."""
    return b"(" + b"".join(items) + b"t"


def integers(values: Any) -> bytes:
    return row(*(integer(value) for value in values))


def call(function: bytes, *arguments: bytes) -> bytes:
    return function + row(*arguments) + b"R"


ORDERED = call(name("collections", "OrderedDict"))
REBUILD = name("torch._utils", "_rebuild_tensor_v2")


def storage(
    kind: str = "FloatStorage",
    key: bytes | str = "0",
    count: int | bytes = 6,
    *,
    tag: bytes = text("storage"),
    place: bytes = text("cuda:0"),
    more: bytes = b"",
) -> bytes:
    """Return the instructions for the persistent id of a storage."""
    number = count if isinstance(count, bytes) else integer(count)
    key = text(key) if isinstance(key, str) else key
    return row(tag, name("torch", kind), key, place, number, more) + b"Q"


def tensor(
    on: bytes | None = None,
    size: Any = (2, 3),
    stride: Any = (3, 1),
    *,
    offset: int = 0,
    more: tuple[bytes, ...] = (b"\x89", ORDERED),
) -> bytes:
    """Return the instructions for a tensor."""
    on = storage() if on is None else on
    return call(REBUILD, on, integer(offset), integers(size), integers(stride), *more)


def mapping(**items: bytes) -> bytes:
    return b"}(" + b"".join(text(key) + value for key, value in items.items()) + b"u"


def program(*parts: bytes, protocol: int = 2) -> bytes:
    return bytes([0x80, protocol]) + b"".join(parts) + b"."


def frame(content: bytes) -> bytes:
    return b"\x95" + struct.pack("<Q", len(content)) + content


GOOD = program(mapping(w=tensor()))

# --- files


def described(crc: int, size: int) -> bytes:
    return struct.pack("<4s3I", b"PK\x07\x08", crc, size, size)


def entries(
    pickle: bytes = GOOD,
    data: dict[str, bytes] | None = None,
    *,
    root: str = "archive",
    version: bytes | None = b"3\n",
    byteorder: bytes | None = b"little",
) -> list[Entry]:
    """Return the members of an archive of torch."""
    storages = {"0": VALUES} if data is None else data
    parts: list[tuple[str, bytes | None]] = [
        ("data.pkl", pickle),
        (".format_version", b"1"),
        (".storage_alignment", b"64"),
        ("byteorder", byteorder),
        *((f"data/{key}", content) for key, content in storages.items()),
        ("version", version),
        (".data/serialization_id", b"0" * 40),
    ]
    return [torch_entry(f"{root}/{key}", content) for key, content in parts if content is not None]


def torch_entry(path: str, content: bytes) -> Entry:
    """Return a member as torch stores it: sizes and checksum follow the data."""
    entry = Entry(path, content, both={"flags": 0x808}, local={"crc": 0, "packed": 0, "size": 0})
    entry.after = described(entry.fields()["crc"], len(content))
    return entry


def archive(pickle: bytes = GOOD, data: dict[str, bytes] | None = None, **more: Any) -> bytes:
    """Return an archive of `torch.save`, which always has a ZIP64 end record."""
    return forge(entries(pickle, data, **more), end64={})


SYSTEM = b"\x80\x02}(" + text("protocol_version") + b"M\xe9\x03" + text("little_endian") + b"\x88u."


def legacy(
    value: bytes | None = None,
    *,
    magic: bytes = b"\x80\x02" + MAGIC + b".",
    version: bytes = b"\x80\x02M\xe9\x03.",
    system: bytes = SYSTEM,
    keys: bytes = b"\x80\x02](" + text("0") + b"e.",
    storages: bytes = struct.pack("<q", 6) + VALUES,
) -> bytes:
    """Return a file in the layout before torch 1.6."""
    value = program(mapping(w=tensor(storage(more=b"N")))) if value is None else value
    return magic + version + system + value + keys + storages
