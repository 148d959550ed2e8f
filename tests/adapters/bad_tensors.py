"""Checkpoints whose storages and tensors do not fit each other or the file, or are of kinds not read."""

from __future__ import annotations

from msb.adapters.checkpoint.names import OTHER_TENSORS
from tests.adapters.assemble import (
    ORDERED,
    REBUILD,
    VALUES,
    Case,
    archive,
    call,
    integer,
    integers,
    mapping,
    name,
    program,
    row,
    storage,
    tensor,
    text,
)

HUGE = 1 << 62


def bad(label: str, code: str, pickle: bytes, data: dict[str, bytes] | None = None) -> Case:
    return Case(label, f"CHECKPOINT_{code}", lambda: archive(program(pickle), data))


def window(label: str, code: str, *shape: object, **more: int) -> Case:
    return bad(f"tensor_{label}", f"TENSOR_{code}", tensor(None, *shape, **more))


OTHER_TYPES = "ComplexFloat ComplexDouble QInt8 QUInt8 QInt32 QUInt4x2 QUInt2x4"

STORAGE_CASES = [
    bad("storage_missing", "STORAGE_MISSING", tensor(storage(key="1"))),
    bad("storage_none", "STORAGE_MISSING", tensor(), {}),
    bad("storage_other_root", "STORAGE_MISSING", tensor(storage(key="00"))),
    bad("storage_short", "STORAGE_SIZE", tensor(), {"0": VALUES[:20]}),
    bad("storage_odd", "STORAGE_SIZE", tensor(), {"0": VALUES[:-1]}),
    bad("storage_long", "STORAGE_SIZE", tensor(), {"0": VALUES * 2}),
    bad("storage_empty", "STORAGE_SIZE", tensor(), {"0": b""}),
    bad("storage_huge", "STORAGE_SIZE", tensor(storage(count=HUGE))),
    bad("storage_wraps", "STORAGE_SIZE", tensor(storage(count=HUGE + 6))),
    bad("storage_double", "STORAGE_SIZE", tensor(storage("DoubleStorage"))),
    bad("storage_conflict", "STORAGE_CONFLICT", row(tensor(), tensor(storage("IntStorage")))),
    bad("storage_conflict_size", "STORAGE_CONFLICT", row(tensor(), tensor(storage(count=5)))),
    *(
        bad(f"type_{kind.lower()}", "TENSOR_DTYPE", tensor(storage(f"{kind}Storage")))
        for kind in OTHER_TYPES.split()
    ),
    bad(
        "type_untyped",
        "TENSOR_DTYPE",
        row(text("storage"), name("torch.storage", "UntypedStorage"), text("0"), text("cpu"), b"K\x18")
        + b"Q",
    ),
    bad("type_bool", "TENSOR_BOOL", tensor(storage("BoolStorage")), {"0": b"\0\1\2\0\0\0"}),
    *(bad(f"kind{what}", "TENSOR_KIND", call(name("torch._utils", what), b"N")) for what in OTHER_TENSORS),
]

WINDOW_CASES = [
    window("one_over", "RANGE", (7,), (1,)),
    window("offset", "RANGE", (2, 3), (3, 1), offset=1),
    window("offset_far", "RANGE", (1,), (1,), offset=HUGE),
    window("offset_wraps", "RANGE", (6,), (1,), offset=HUGE),
    window("offset_negative", "RANGE", (2,), (1,), offset=-1),
    window("offset_empty", "RANGE", (0,), (1,), offset=7),
    window("stride_far", "RANGE", (2, 3), (4, 1)),
    window("stride_huge", "RANGE", (2, 1), (HUGE, 1)),
    window("stride_negative", "STRIDE", (6,), (-1,), offset=5),
    window("stride_few", "STRIDE", (2, 3), (3,)),
    window("stride_many", "STRIDE", (2, 3), (3, 1, 1)),
    window("size_negative", "SHAPE", (-1, 3), (3, 1)),
    window("size_negatives", "SHAPE", (-2, -3), (3, 1)),
    window("size_overflow", "SHAPE", (1 << 33, 1 << 33), (1, 1)),
    window("size_empty_overflow", "SHAPE", (0, HUGE, HUGE), (1, 1, 1)),
    window("size_axes", "SHAPE", (1,) * 33, (1,) * 33),
    window("size_many_axes", "SHAPE", (1,) * 10_000, (1,) * 10_000),
    window("expanded", "EXPANDED", (1 << 40,), (0,)),
    window("expanded_rows", "EXPANDED", (7, 1), (0, 1)),
    window("expanded_overlap", "EXPANDED", (5, 2), (1, 1)),
]


def made(label: str, *arguments: bytes) -> Case:
    return bad(f"made_{label}", "TENSOR_ARGUMENTS", call(REBUILD, *arguments))


SIZE, STRIDE, REST = integers((2, 3)), integers((3, 1)), (b"\x89", ORDERED)
ARGUMENT_CASES = [
    made("of_nothing"),
    made("of_five", storage(), b"K\0", SIZE, STRIDE, b"\x89"),
    made("of_seven", storage(), b"K\0", SIZE, STRIDE, *REST, mapping(neg=b"\x88")),
    made("of_list", b"]", b"K\0", SIZE, STRIDE, *REST),
    made("of_tensor", tensor(), b"K\0", SIZE, STRIDE, *REST),
    made("of_type", name("torch", "FloatStorage"), b"K\0", SIZE, STRIDE, *REST),
    made("offset_text", storage(), text("0"), SIZE, STRIDE, *REST),
    made("offset_bool", storage(), b"\x88", SIZE, STRIDE, *REST),
    made("size_list", storage(), b"K\0", b"](K\2K\3e", STRIDE, *REST),
    made("size_float", storage(), b"K\0", row(b"G" + bytes(8)), integers((1,)), *REST),
    made("size_bool", storage(), b"K\0", row(b"\x88"), integers((1,)), *REST),
    made("stride_none", storage(), b"K\0", SIZE, b"N", *REST),
    bad(
        "parameter_of_number",
        "TENSOR_ARGUMENTS",
        call(name("torch._utils", "_rebuild_parameter"), integer(1), *REST),
    ),
    bad("parameter_alone", "TENSOR_ARGUMENTS", call(name("torch._utils", "_rebuild_parameter"), tensor())),
]

CASES = [*STORAGE_CASES, *WINDOW_CASES, *ARGUMENT_CASES]
