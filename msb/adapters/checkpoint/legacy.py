"""Read files in the layout that `torch.save` used before torch 1.6: pickles, then raw storages.

`torch.save` can still write this layout on request.

The file has five pickles. The pickles are a magic number, the number 1001, properties of the machine, the
saved value, and the list of storage keys. The storages follow. Each storage consists of its number of
elements (64 bits), followed by the elements. The pickle of the saved value states the types of the storages,
and these types determine the positions of later storages. The pickle is therefore interpreted twice. The
first run collects the storages and their types. The second run knows the positions of the storages. Source:
pytorch/pytorch `torch/serialization.py` (`_legacy_save`).
"""

import re
import struct
from typing import Any

from msb.adapters.checkpoint.archive import MAX_PICKLE
from msb.adapters.checkpoint.pickle_machine import run_pickle
from msb.adapters.checkpoint.tensors import DeclaredStorages, Extent, Refusal, Storages, Unfinished

MAGIC_NUMBER = 0x1950A86A20F9469CFC6C
PROTOCOL_VERSION = 1001
# Maximum number of storages of a file, equal to the maximum number of members of an archive.
MAX_STORAGES = 20_000

_COUNT = struct.Struct("<q")
_START = re.compile(
    rb"\x80[\x02-\x04](\x95.{8})?\x8a\x0a" + re.escape(MAGIC_NUMBER.to_bytes(10, "little")), re.DOTALL
)


def is_legacy(head: bytes) -> bool:
    """Return whether a file that begins with the bytes `head` has this layout."""
    return _START.match(head) is not None


def read_legacy(view: memoryview) -> Any:
    """Return the value that was saved in the file `view`."""
    position = 0
    header = []
    for _ in range(3):
        value, position = _pickle_at(view, position)
        header.append(value)
    _check_header(*header)
    # First run: collect the storages that the pickle declares. Find the positions of the storages. Then run
    # the pickle again.
    start = position
    declared = DeclaredStorages()
    _, position = _pickle_at(view, start, declared)
    keys, position = _pickle_at(view, position)
    places = _places(view, position, keys, declared)
    return _pickle_at(view, start, Storages(view, places))[0]


def _pickle_at(view: memoryview, start: int, storages: Storages | None = None) -> tuple[Any, int]:
    """Return the value of the pickle that begins at byte `start` of the file, and the position of its end."""
    data = bytes(view[start : start + MAX_PICKLE])
    try:
        value, end = run_pickle(data, storages, origin=start)
    except Unfinished as refusal:
        if start + MAX_PICKLE < len(view):
            text = f"a pickle has more than {MAX_PICKLE} bytes"
            raise Refusal("CHECKPOINT_FORM", text, at=refusal.at) from None
        raise
    return value, start + end


def _check_header(magic: Any, version: Any, system: Any) -> None:
    """Check the values of the first three pickles."""
    if type(magic) is not int or magic != MAGIC_NUMBER:
        raise Refusal("CHECKPOINT_DAMAGED", "the file does not start with the magic number of torch")
    if type(version) is not int or version != PROTOCOL_VERSION:
        text = f"the number {PROTOCOL_VERSION} does not follow the magic number of torch"
        raise Refusal("CHECKPOINT_DAMAGED", text)
    little = system.get("little_endian") if type(system) is dict else None
    if type(little) is not bool:
        text = "the file does not state the byte order of its machine"
        raise Refusal("CHECKPOINT_DAMAGED", text)
    if not little:
        raise Refusal("CHECKPOINT_FORM", "the file was written on a big-endian machine")


def _places(view: memoryview, position: int, keys: Any, declared: DeclaredStorages) -> dict[str, Extent]:
    """Return the positions of the storages. In the order of `keys`, the storages fill the rest of the
    file."""
    known = declared.declared
    if len(known) > MAX_STORAGES or type(keys) is not list or len(keys) != len(known):
        text = f"the list of keys does not match the {len(known)} storages"
        raise Refusal("CHECKPOINT_DAMAGED", text, at=f"byte {position}")
    places: dict[str, Extent] = {}
    for key in keys:
        at = f"byte {position}"
        if type(key) is not str or key not in known or key in places:
            text = "the list of keys has a storage twice, or a storage that no tensor uses"
            raise Refusal("CHECKPOINT_DAMAGED", text, at=at)
        storage = known[key]
        assert storage.kind.dtype is not None
        length = storage.count * storage.kind.dtype.itemsize
        end = position + _COUNT.size + length
        if end > len(view):
            raise Refusal("CHECKPOINT_DAMAGED", f"the file ends before storage {key} is complete", at=at)
        (count,) = _COUNT.unpack_from(view, position)
        if count != storage.count:
            text = f"storage {key} has {count} elements, but the pickle declares {storage.count}"
            raise Refusal("CHECKPOINT_DAMAGED", text, at=at)
        places[key] = Extent(position + _COUNT.size, length)
        position = end
    if position != len(view):
        text = f"{len(view) - position} bytes follow the last storage"
        raise Refusal("CHECKPOINT_DAMAGED", text, at=f"byte {position}")
    return places
