"""Checkpoints whose data.pkl does wrong things with the stack, the memo, calls and results."""

from __future__ import annotations

from msb.adapters.checkpoint.pickle_machine import MAX_MEMO, MAX_OPCODES
from msb.adapters.checkpoint.reader import MAX_DEPTH
from tests.adapters.assemble import ORDERED, call, name, program, row, storage, tensor, text
from tests.adapters.bad_pickles import bad

# --- stack, marks and memo ----------------------------------------------------------------------------

STACK_CASES = [
    bad("stack_append", "HOSTILE", program(b"N" + b"a")),
    bad("mark_appends", "HOSTILE", program(b"]Ne")),
    bad("mark_many", "HOSTILE", lambda: program(b"(" * 100_000, b"N")),
    bad("memo_unset", "HOSTILE", program(b"h\x07")),
    bad("memo_mix", "HOSTILE", program(b"Nq\0", protocol=4)),
    bad("memo_many", "HOSTILE", lambda: program(b"N" + b"\x94" * (MAX_MEMO + 1), protocol=4)),
    bad("item_append", "HOSTILE", program(b"}Na")),
    bad("item_appends", "HOSTILE", program(b")(Ne")),
    bad("item_setitem", "HOSTILE", program(b"]NNs")),
    bad("item_setitems", "HOSTILE", program(tensor(), b"(", text("a"), b"Nu")),
    bad("item_odd", "HOSTILE", program(b"}(NNNu")),
    *(
        bad(f"key_{label}", "FORM", program(b"}", key, b"Ns"))
        for label, key in (
            ("list", b"]"),
            ("bool", b"\x88"),
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
EIGHT = call(ENCODE, text("\0" * 8), text("latin1"))

CALL_CASES = [
    bad("call_number", "HOSTILE", program(b"K\x01)R")),
    bad("call_result", "HOSTILE", program(ORDERED, b")R")),
    bad("call_ordered", "HOSTILE", program(call(name("collections", "OrderedDict"), b"]"))),
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
    bad("scalar_type_number", "FORM", program(call(name("numpy", "dtype"), b"K\x08", b"\x89", b"\x88"))),
    bad("scalar_short", "FORM", program(call(SCALAR, F8, call(ENCODE, text("x"), text("latin1"))))),
    bad("scalar_no_type", "FORM", program(call(SCALAR, text("f8"), EIGHT))),
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
            ("of_negative_size", storage(count=-6)),
        )
    ),
]

# --- results ------------------------------------------------------------------------------------------


def laughs(levels: int) -> bytes:
    """Lists that hold the one before twice."""
    parts = [b"]q\0"]
    for level in range(1, levels):
        parts.append(b"](h%ch%ceq%c" % (level - 1, level - 1, level))
    # All lists are on the stack; a tuple of the lot keeps one result.
    return program(b"(", *parts, b"t")


RESULT_CASES = [
    bad("result_function", "FORM", program(name("collections", "OrderedDict"))),
    bad("result_dtype", "FORM", program(row(F8))),
    bad("cycle_ordered", "HOSTILE", program(ORDERED, b"q\0K\0h\0s")),
    bad("deep_lists", "HOSTILE", program(b"]" * (MAX_DEPTH + 1), b"a" * MAX_DEPTH)),
    bad(
        "deep_shared",
        "HOSTILE",
        program(b"(]q\0" + b"".join(b"]h%caq%c" % (n - 1, n) for n in range(1, 70)) + b"t"),
    ),
    bad("laughs", "HOSTILE", laughs(40)),
    bad("laughs_tuples", "HOSTILE", program(b")" + b"".join(b"q%ch%c\x86" % (n, n) for n in range(40)))),
    bad("many_opcodes", "FORM", lambda: program(b"(" + b"N" * MAX_OPCODES + b"t")),
    bad("too_large", "FORM", lambda: program(text(b"x" * (16 << 20)))),
]

CASES = [*STACK_CASES, *CALL_CASES, *RESULT_CASES]
