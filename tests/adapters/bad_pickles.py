"""Checkpoints whose data.pkl is a bad program: names, instructions, stack, memo, frames, limits."""

from __future__ import annotations

import pickletools
from collections.abc import Callable

from tests.adapters.assemble import Case, archive, call, frame, name, program, row, short_text, text


def bad(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    """Return a case with the given program as data.pkl."""
    build = make if callable(make) else lambda: make
    return Case(f"pickle_{label}", f"CHECKPOINT_{code}", lambda: archive(build()))


# --- names: what a stranger would call ---------------------------------------------------------------

STRANGERS = """
os.system subprocess.Popen builtins.eval builtins.getattr builtins.__import__ builtins.set runpy._run_code
pickle.loads importlib.import_module operator.methodcaller functools.partial types.CodeType sys.modules
copyreg._reconstructor collections.defaultdict collections.ordereddict codecs.encode torch.load torch.Size
torch._utils._import_dotted_name torch.storage._load_from_bytes torch.nn.modules.linear.Linear numpy.ndarray
numpy._core.multiarray._reconstruct argparse.Namespace omegaconf.dictconfig.DictConfig msb.export
"""

ODD_NAMES = [
    ("dotted", "torch._utils", "_rebuild_tensor_v2.__globals__"),
    ("dotted_method", "collections", "OrderedDict.fromkeys"),
    ("space", "collections ", "OrderedDict"),
    ("nul", "collections\0", "OrderedDict"),
    ("no_module", "", "eval"),
    ("greek_letter", "c\u03bfllections", "OrderedDict"),
    ("escape_sequence", "\x1b[2J", "clear"),
    ("long", "x" * 199, "y"),
]


def attack(module: str, what: str) -> bytes:
    return program(call(name(module, what), text("echo hacked > /tmp/hacked")))


NAME_CASES = [
    *(bad(f"name_{full}", "HOSTILE", attack(*full.rsplit(".", 1))) for full in STRANGERS.split()),
    *(bad(f"name_{label}", "HOSTILE", attack(m, n)) for label, m, n in ODD_NAMES),
    bad("name_too_long", "HOSTILE", program(name("x" * 300, "y"))),
    bad(
        "name_from_stack",
        "HOSTILE",
        program(short_text("os"), short_text("system"), b"\x93", row(text("id")), b"R", protocol=4),
    ),
    bad("name_number", "HOSTILE", program(b"K\x01K\x02\x93", protocol=4)),
    bad(
        "name_dotted_from_stack",
        "HOSTILE",
        program(short_text("torch"), short_text("_utils._rebuild_tensor_v2"), b"\x93", protocol=4),
    ),
    bad("name_not_utf8", "HOSTILE", b"\x80\x02c\xff\xfe\nx\n."),
]

# --- instructions we do not have ----------------------------------------------------------------------

USED = """
PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 BINFLOAT LONG1 LONG4 BINUNICODE
SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 EMPTY_LIST APPEND APPENDS EMPTY_TUPLE TUPLE
TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT SETITEM SETITEMS BINPUT LONG_BINPUT MEMOIZE BINGET LONG_BINGET GLOBAL
STACK_GLOBAL BINPERSID REDUCE BUILD
"""
ARGUMENTS = {
    "INST": b"os\nsystem\n",
    "PERSID": b"0\n",
    "GET": b"0\n",
    "PUT": b"0\n",
    "EXT1": b"\x01",
    "EXT2": b"\x01\0",
    "EXT4": b"\x01\0\0\0",
}
OPCODE_CASES = [
    *(
        bad(
            f"opcode_{op.name.lower()}",
            "HOSTILE",
            program(b"(N" + op.code.encode("latin1") + ARGUMENTS.get(op.name, b"1\n"), protocol=4),
        )
        for op in pickletools.opcodes
        if op.name not in USED.split()
    ),
    bad("opcode_zero", "HOSTILE", program(b"\0")),
    bad("protocol_0", "FORM", program(b"N", protocol=0)),
    bad("protocol_early_memoize", "FORM", program(b"N\x94")),
]

# --- where it ends ------------------------------------------------------------------------------------

END_CASES = [
    bad("empty", "DAMAGED", b""),
    bad("trailing", "HOSTILE", program(b"N") + b"N"),
    bad("cut_name", "DAMAGED", b"\x80\x02ccollections\nOrd"),
    bad("integer_long1", "HOSTILE", program(b"\x8a\xff" + bytes(255))),
    bad("frame_nested", "HOSTILE", program(frame(frame(b"N") + b"0"), protocol=4)),
    bad("frame_splits", "HOSTILE", program(frame(b"J\x01") + b"\0\0\0", protocol=4)),
    bad("frame_past_stop", "HOSTILE", b"\x80\x04" + frame(b"N.N")),
]

CASES = [*NAME_CASES, *OPCODE_CASES, *END_CASES]
