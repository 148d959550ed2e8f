"""A safe interpreter for the part of the pickle format that checkpoints use.

A pickle is a program for a small stack machine. Python's own interpreter imports and calls everything that
the program names, so it must never load an untrusted pickle. This interpreter has the 40 instructions that
are needed for dicts, lists, tuples, text, numbers and tensors. Names select functions from the list in
`names.py`. Unsupported instructions and names raise an error. Sources for the meaning of instructions: the
comments of python/cpython `Lib/pickletools.py`, and PEP 3154 for protocol 4.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msb.adapters.checkpoint.names import Function, ScalarType, find
from msb.adapters.checkpoint.tensors import DeclaredStorages, Refusal, Unfinished

if TYPE_CHECKING:
    from msb.adapters.checkpoint.tensors import Storages

# Maximum number of instructions. A few thousand instructions are usual. A list with the losses of all
# training steps adds 10,000 instructions. An instruction can need some hundred bytes, for example for an
# empty dict. The limit therefore bounds the memory to some hundred MiB.
MAX_OPCODES = 1_000_000
# Maximum number of memo entries. The maximum is half of MAX_OPCODES, because an entry takes two instructions:
# one creates the value, one stores it.
MAX_MEMO = 500_000
# Maximum size of an integer in bytes. The magic number of torch takes 10 bytes; sizes and seeds take fewer
# bytes.
MAX_INTEGER_BYTES = 16
# Maximum length of a line of the instruction GLOBAL, in bytes.
MAX_NAME = 200
# Supported protocols. torch uses protocol 2 by default; no file of torch with protocol 5 is known.
PROTOCOLS = range(2, 5)

_MISSING = object()
_U8, _U16, _I32, _U32, _U64 = (struct.Struct(f"<{code}") for code in "BHiIQ")
_F64 = struct.Struct(">d")  # this is the only big-endian number in a pickle


class _Machine:
    """The state of the stack machine while it runs the program `data`."""

    def __init__(self, data: bytes, storages: Storages) -> None:
        self.data, self.storages = data, storages
        self.position = self.at = 0
        self.protocol = 0
        self.frame_end: int | None = None
        self.stack: list[Any] = []
        # The part of the stack below each open mark.
        self.below: list[list[Any]] = []
        self.memo: dict[int, Any] = {}
        # The dictionaries, by id, that the file declares as OrderedDict. Only OrderedDicts can have
        # attributes.
        self.ordered: dict[int, dict[Any, Any]] = {}

    def run(self) -> Any:
        """Run the program up to the STOP instruction, and return the program's result."""
        for _ in range(MAX_OPCODES):
            self.at = self.position
            if self.position >= len(self.data):
                raise Unfinished("CHECKPOINT_DAMAGED", "the pickle ends without STOP")
            code = self.data[self.position]
            self.position += 1
            follow = INSTRUCTIONS.get(code)
            if follow is None:
                text = f"instruction {code:#04x} is not supported: plain data and tensors do not need it"
                raise Refusal("CHECKPOINT_HOSTILE", text)
            if _SINCE.get(code, PROTOCOLS.start) > self.protocol and code != 0x80:
                text = f"instruction {code:#04x} does not belong to protocol {self.protocol}"
                raise Refusal("CHECKPOINT_FORM", text)
            follow(self)
            self.check_frame()
            if code == 0x2E:
                return self.stack[0]
        raise Refusal("CHECKPOINT_FORM", f"the pickle has more than {MAX_OPCODES} instructions")

    # --- arguments

    def take(self, count: int) -> bytes:
        """Read and return the next `count` bytes of the program."""
        end = self.position + count
        if end > len(self.data):
            text = f"an instruction declares {count} bytes, but {len(self.data) - self.position} are left"
            raise Unfinished("CHECKPOINT_DAMAGED", text)
        taken = self.data[self.position : end]
        self.position = end
        return taken

    def number(self, layout: struct.Struct) -> Any:
        return layout.unpack(self.take(layout.size))[0]

    def line(self) -> str:
        """Read the next line and return it as a name."""
        end = self.data.find(b"\n", self.position, self.position + MAX_NAME + 1)
        if end < 0:
            text = f"a name does not end within {MAX_NAME} bytes"
            if self.position + MAX_NAME < len(self.data):
                raise Refusal("CHECKPOINT_HOSTILE", text)
            raise Unfinished("CHECKPOINT_DAMAGED", text)
        return _text(self.take(end + 1 - self.position)[:-1])

    # --- stack and memo

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def pop(self) -> Any:
        if not self.stack:
            raise Refusal("CHECKPOINT_HOSTILE", "the stack is empty above the last mark")
        return self.stack.pop()

    def top(self) -> Any:
        self.push(self.pop())
        return self.stack[-1]

    def pop_to_mark(self) -> list[Any]:
        if not self.below:
            raise Refusal("CHECKPOINT_HOSTILE", "items are collected above a mark that does not exist")
        items, self.stack = self.stack, self.below.pop()
        return items

    def put(self, index: int, *, memoize: bool = False) -> None:
        """Store the top of the stack in the memo.

        Only protocol 4 has memo entries without a number (MEMOIZE).
        """
        if memoize != (self.protocol >= 4) or index in self.memo:
            text = f"memo entry {index} is set twice, or by an instruction of another protocol"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        if len(self.memo) >= MAX_MEMO:
            raise Refusal("CHECKPOINT_HOSTILE", f"more than {MAX_MEMO} memo entries")
        self.memo[index] = self.top()

    def get(self, index: int) -> None:
        value = self.memo.get(index, _MISSING)
        if value is _MISSING:
            raise Refusal("CHECKPOINT_HOSTILE", f"memo entry {index} is used before it is set")
        self.push(value)

    # --- the protocol and its frames

    def set_protocol(self) -> None:
        version = self.number(_U8)
        if self.protocol or version not in PROTOCOLS:
            text = f"the pickle has protocol {version}, or states it twice; 2 to 4 are supported"
            raise Refusal("CHECKPOINT_FORM", text)
        self.protocol = version

    def open_frame(self) -> None:
        length = self.number(_U64)
        if self.frame_end is not None or length > len(self.data) - self.position:
            text = f"a frame of {length} bytes does not fit, or starts inside another frame"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        self.frame_end = self.position + length

    def check_frame(self) -> None:
        """Check that a frame ends between two instructions."""
        if self.frame_end is None or self.position < self.frame_end:
            return
        if self.position > self.frame_end:
            raise Refusal("CHECKPOINT_HOSTILE", "a frame ends inside an instruction")
        self.frame_end = None

    def stop(self) -> None:
        if self.below:
            raise Refusal("CHECKPOINT_HOSTILE", "a mark is open at the end")
        if len(self.stack) != 1:
            raise Refusal(
                "CHECKPOINT_HOSTILE", f"{len(self.stack)} values are left on the stack instead of one value"
            )
        if self.frame_end is not None and self.frame_end != self.position:
            raise Refusal("CHECKPOINT_HOSTILE", "the last frame is longer than its content")

    # --- values

    def mark(self) -> None:
        self.below.append(self.stack)
        self.stack = []

    def push_text(self, layout: struct.Struct) -> None:
        self.push(_text(self.take(self.number(layout))))

    def push_integer(self, layout: struct.Struct) -> None:
        length = self.number(layout)
        if not 0 <= length <= MAX_INTEGER_BYTES:
            text = f"an integer has {length} bytes; at most {MAX_INTEGER_BYTES} are supported"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        self.push(int.from_bytes(self.take(length), "little", signed=True))

    def push_tuple(self, count: int) -> None:
        items = [self.pop() for _ in range(count)]
        self.push(tuple(reversed(items)))

    def append(self, items: list[Any]) -> None:
        target = self.top()
        if type(target) is not list:
            raise Refusal(
                "CHECKPOINT_HOSTILE", f"an item is appended to a {type(target).__name__}, not to a list"
            )
        target += items

    def set_items(self, items: list[Any]) -> None:
        target = self.top()
        if type(target) is not dict or len(items) % 2:
            text = f"keys and values are added to a {type(target).__name__}, not to a dict, or are not pairs"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        for key, value in zip(items[::2], items[1::2], strict=True):
            # Keys must have types with a fast hash. Hashing a nested tuple can take 2^50 steps.
            if type(key) is not str and not (type(key) is int and -(1 << 63) <= key < 1 << 63):
                text = f"a key is a {type(key).__name__}; text and 64-bit integers are supported"
                raise Refusal("CHECKPOINT_FORM", text)
            if key in target:
                raise Refusal("CHECKPOINT_HOSTILE", "a dictionary has the same key twice")
            target[key] = value

    def pop_pair(self) -> list[Any]:
        value = self.pop()
        return [self.pop(), value]

    # --- names and calls

    def name_from_stack(self) -> None:
        module, name = self.pop_pair()
        if type(module) is not str or type(name) is not str:
            raise Refusal("CHECKPOINT_HOSTILE", "a name is not text")
        self.push(find(module, name))

    def call(self) -> None:
        function, arguments = self.pop_pair()
        if type(function) is not Function or type(arguments) is not tuple:
            text = f"a {type(function).__name__} is called with a {type(arguments).__name__}"
            raise Refusal("CHECKPOINT_HOSTILE", text)
        result = function.apply(self.storages, arguments)
        if type(result) is dict:
            self.ordered[id(result)] = result
        self.push(result)

    def build(self) -> None:
        """Ignore the attributes of an OrderedDict (`_metadata`) and the default state of a NumPy type.

        Reject other attribute states.
        """
        state, target = self.pop(), self.top()
        if id(target) in self.ordered:
            accepted = type(state) is dict
        else:
            accepted = type(target) is ScalarType and target.accepts_state(state)
        if not accepted:
            text = f"a {type(target).__name__} has an invalid state"
            raise Refusal("CHECKPOINT_HOSTILE", text)


def _text(raw: bytes) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise Refusal("CHECKPOINT_HOSTILE", f"text is not UTF-8: {error.reason}") from None


def _push(make: Callable[[], Any]) -> Callable[[_Machine], None]:
    return lambda machine: machine.push(make())


def _push_number(layout: struct.Struct) -> Callable[[_Machine], None]:
    return lambda machine: machine.push(machine.number(layout))


def _push_bytes(layout: struct.Struct) -> Callable[[_Machine], None]:
    return lambda machine: machine.push(machine.take(machine.number(layout)))


# The handler of each instruction byte. The comments give the names of the instructions in `pickletools` of
# the standard library.
INSTRUCTIONS: dict[int, Callable[[_Machine], None]] = {
    0x80: _Machine.set_protocol,  # PROTO
    0x2E: _Machine.stop,  # STOP
    0x28: _Machine.mark,  # MARK
    0x4E: _push(lambda: None),  # NONE
    0x88: _push(lambda: True),  # NEWTRUE
    0x89: _push(lambda: False),  # NEWFALSE
    0x4A: _push_number(_I32),  # BININT
    0x4B: _push_number(_U8),  # BININT1
    0x4D: _push_number(_U16),  # BININT2
    0x47: _push_number(_F64),  # BINFLOAT
    0x8A: lambda m: m.push_integer(_U8),  # LONG1
    0x8B: lambda m: m.push_integer(_I32),  # LONG4
    0x58: lambda m: m.push_text(_U32),  # BINUNICODE
    0x5D: _push(list),  # EMPTY_LIST
    0x61: lambda m: m.append([m.pop()]),  # APPEND
    0x65: lambda m: m.append(m.pop_to_mark()),  # APPENDS
    0x29: _push(tuple),  # EMPTY_TUPLE
    0x74: lambda m: m.push(tuple(m.pop_to_mark())),  # TUPLE
    0x85: lambda m: m.push_tuple(1),  # TUPLE1
    0x86: lambda m: m.push_tuple(2),  # TUPLE2
    0x87: lambda m: m.push_tuple(3),  # TUPLE3
    0x7D: _push(dict),  # EMPTY_DICT
    0x73: lambda m: m.set_items(m.pop_pair()),  # SETITEM
    0x75: lambda m: m.set_items(m.pop_to_mark()),  # SETITEMS
    0x71: lambda m: m.put(m.number(_U8)),  # BINPUT
    0x72: lambda m: m.put(m.number(_U32)),  # LONG_BINPUT
    0x68: lambda m: m.get(m.number(_U8)),  # BINGET
    0x6A: lambda m: m.get(m.number(_U32)),  # LONG_BINGET
    0x63: lambda m: m.push(find(m.line(), m.line())),  # GLOBAL
    0x51: lambda m: m.push(m.storages.storage(m.pop())),  # BINPERSID
    0x52: _Machine.call,  # REDUCE
    0x62: _Machine.build,  # BUILD
    0x42: _push_bytes(_U32),  # BINBYTES
    0x43: _push_bytes(_U8),  # SHORT_BINBYTES
    0x95: _Machine.open_frame,  # FRAME
    0x8C: lambda m: m.push_text(_U8),  # SHORT_BINUNICODE
    0x8D: lambda m: m.push_text(_U64),  # BINUNICODE8
    0x8E: _push_bytes(_U64),  # BINBYTES8
    0x94: lambda m: m.put(len(m.memo), memoize=True),  # MEMOIZE
    0x93: _Machine.name_from_stack,  # STACK_GLOBAL
}
# For each instruction byte, the first protocol with this instruction. Instructions that are not in this
# table belong to protocol 2 or earlier.
_SINCE = dict.fromkeys(b"\x42\x43", 3) | dict.fromkeys(b"\x95\x8c\x8d\x8e\x94\x93", 4)


def run_pickle(
    data: bytes, storages: Storages | None = None, *, where: str = "", origin: int = 0
) -> tuple[Any, int]:
    """Run the pickle at the beginning of `data`. Return the pickle's value and the position of its end.

    Without `storages`, all tensors in the value are empty. `where` and `origin` are for error messages.
    The texts give the name of the archive member, such as "data.pkl ", and the position of `data` in the
    file.
    """
    machine = _Machine(data, DeclaredStorages() if storages is None else storages)
    try:
        return machine.run(), machine.position
    except Refusal as refusal:
        refusal.at = f"{where}byte {machine.at + origin}"
        raise
