"""Checkpoints with an invalid data.pkl: wrong names, opcodes, endings, calls or results."""

import pickletools
from collections.abc import Callable

from msb.adapters.checkpoint.pickle_machine import MAX_MEMO, MAX_OPCODES
from msb.adapters.checkpoint.reader import MAX_DEPTH
from tests.adapters.assemble import (
    ORDERED,
    Case,
    archive,
    call,
    frame,
    name,
    program,
    row,
    short_text,
    storage,
    tensor,
    text,
)


def bad(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    """Return a case with the given program as data.pkl."""
    build = make if callable(make) else lambda: make
    return Case(f"pickle_{label}", f"CHECKPOINT_{code}", lambda: archive(build()))


# --- names that an attacker would call ----------------------------------------------------------------

HARMFUL_NAMES = """
os.system subprocess.Popen builtins.eval builtins.getattr builtins.__import__ builtins.set runpy._run_code
pickle.loads importlib.import_module operator.methodcaller functools.partial types.CodeType sys.modules
copyreg._reconstructor collections.defaultdict collections.ordereddict codecs.encode torch.load torch.Size
torch._utils._import_dotted_name torch.storage._load_from_bytes torch.nn.modules.linear.Linear numpy.ndarray
numpy._core.multiarray._reconstruct argparse.Namespace omegaconf.dictconfig.DictConfig msb.export
"""

ODD_NAMES = [
    ("dotted", "torch._utils", "_rebuild_tensor_v2.__globals__"),
    ("dotted_method", "collections", "OrderedDict.fromkeys"),
    ("no_module", "", "eval"),
]


def attack(module: str, what: str) -> bytes:
    return program(call(name(module, what), text("echo hacked > /tmp/hacked")))


NAME_CASES = [
    *(bad(f"name_{full}", "HOSTILE", attack(*full.rsplit(".", 1))) for full in HARMFUL_NAMES.split()),
    *(bad(f"name_{label}", "HOSTILE", attack(m, n)) for label, m, n in ODD_NAMES),
    bad("name_too_long", "HOSTILE", program(name("x" * 300, "y"))),
    bad(
        "name_from_stack",
        "HOSTILE",
        program(short_text("os"), short_text("system"), b"\x93", row(text("id")), b"R", protocol=4),
    ),
    bad(
        "name_dotted_from_stack",
        "HOSTILE",
        program(short_text("torch"), short_text("_utils._rebuild_tensor_v2"), b"\x93", protocol=4),
    ),
    bad("name_not_utf8", "HOSTILE", b"\x80\x02c\xff\xfe\nx\n."),
]

# --- opcodes that the reader rejects ------------------------------------------------------------------

SUPPORTED = """
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
        if op.name not in SUPPORTED.split()
    ),
    bad("opcode_zero", "HOSTILE", program(b"\0")),
    bad("protocol_0", "FORM", program(b"N", protocol=0)),
    bad("protocol_early_memoize", "FORM", program(b"N\x94")),
]

# --- invalid endings ----------------------------------------------------------------------------------

END_CASES = [
    bad("empty", "DAMAGED", b""),
    bad("trailing", "HOSTILE", program(b"N") + b"N"),
    bad("cut_name", "DAMAGED", b"\x80\x02ccollections\nOrd"),
    bad("frame_nested", "HOSTILE", program(frame(frame(b"N") + b"0"), protocol=4)),
    bad("frame_past_stop", "HOSTILE", b"\x80\x04" + frame(b"N.N")),
]


STACK_CASES = [
    bad("stack_append", "HOSTILE", program(b"N" + b"a")),
    bad("mark_many", "HOSTILE", lambda: program(b"(" * 100_000, b"N")),
    bad("memo_unset", "HOSTILE", program(b"h\x07")),
    bad("memo_mix", "HOSTILE", program(b"Nq\0", protocol=4)),
    bad("memo_many", "HOSTILE", lambda: program(b"N" + b"\x94" * (MAX_MEMO + 1), protocol=4)),
    bad("item_append", "HOSTILE", program(b"}Na")),
    bad("item_setitems", "HOSTILE", program(tensor(), b"(", text("a"), b"Nu")),
    bad("item_odd", "HOSTILE", program(b"}(NNNu")),
    *(
        bad(f"key_{label}", "FORM", program(b"}", key, b"Ns"))
        for label, key in (
            ("list", b"]"),
            (
                "tuple_of_2_40_hashes",
                b")" + b"q\0h\0\x86" + b"".join(b"q%ch%c\x86" % (n, n) for n in range(1, 40)),
            ),
        )
    ),
    bad("key_twice", "HOSTILE", program(b"}(" + text("a") + b"N" + text("a") + b"Nu")),
]

# --- calls and states ---------------------------------------------------------------------------------

F8 = call(name("numpy", "dtype"), text("f8"), b"\x89", b"\x88")
SCALAR = name("numpy._core.multiarray", "scalar")
ENCODE = name("_codecs", "encode")

CALL_CASES = [
    bad("call_result", "HOSTILE", program(ORDERED, b")R")),
    bad("call_encode_base64", "HOSTILE", program(call(ENCODE, text("x"), text("base64")))),
    bad(
        "call_encode_long",
        "HOSTILE",
        lambda: program(
            text("x" * (1 << 20)), b"q\0", *(call(ENCODE, b"h\0", text("latin1")) for _ in range(100))
        ),
    ),
    bad("build_dict", "HOSTILE", program(b"}}b")),
    bad("build_dtype_arrays", "HOSTILE", program(F8, row(tensor(), *[b"N"] * 7), b"b")),
    *(
        bad(
            f"scalar_type_{code}",
            "FORM",
            program(call(name("numpy", "dtype"), text(code), b"\x89", b"\x88")),
        )
        for code in ("O8", "U2", ">f8", "f8,f8")
    ),
    bad("scalar_short", "FORM", program(call(SCALAR, F8, call(ENCODE, text("x"), text("latin1"))))),
    bad(
        "scalar_bool",
        "FORM",
        program(
            call(SCALAR, call(name("numpy", "dtype"), text("b1"), b"\x89", b"\x88"), b"C\x01\x02"), protocol=3
        ),
    ),
    *(
        bad(f"persid_{label}", "HOSTILE", program(code))
        for label, code in (
            ("module", storage(tag=text("module"))),
            ("a_path", storage(key="../data.pkl")),
        )
    ),
]

# --- results ------------------------------------------------------------------------------------------


def nested_lists(levels: int) -> bytes:
    """Return nested lists. Each list holds the previous list twice."""
    parts = [b"]q\0"]
    for level in range(1, levels):
        parts.append(b"](h%ch%ceq%c" % (level - 1, level - 1, level))
    # All lists are on the stack. One tuple of them all is the result.
    return program(b"(", *parts, b"t")


RESULT_CASES = [
    bad("result_dtype", "FORM", program(row(F8))),
    bad("cycle_ordered", "HOSTILE", program(ORDERED, b"q\0K\0h\0s")),
    bad("deep_lists", "HOSTILE", program(b"]" * (MAX_DEPTH + 1), b"a" * MAX_DEPTH)),
    bad(
        "deep_shared",
        "HOSTILE",
        program(b"(]q\0" + b"".join(b"]h%caq%c" % (n - 1, n) for n in range(1, 70)) + b"t"),
    ),
    bad("laughs", "HOSTILE", nested_lists(40)),
    bad("many_opcodes", "FORM", lambda: program(b"(" + b"N" * MAX_OPCODES + b"t")),
    bad("too_large", "FORM", lambda: program(text(b"x" * (16 << 20)))),
]

CASES = [*NAME_CASES, *OPCODE_CASES, *END_CASES, *STACK_CASES, *CALL_CASES, *RESULT_CASES]
