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


def bad(label: str, title: str, code: str, pickle: bytes, data: dict[str, bytes] | None = None) -> Case:
    return Case(label, title, f"CHECKPOINT_{code}", lambda: archive(program(pickle), data))


def window(label: str, title: str, code: str, *shape: object, **more: int) -> Case:
    return bad(f"tensor_{label}", title, f"TENSOR_{code}", tensor(None, *shape, **more))


OTHER_TYPES = "ComplexFloat ComplexDouble QInt8 QUInt8 QInt32 QUInt4x2 QUInt2x4"

STORAGE_CASES = [
    bad("storage_missing", "a storage that is not there", "STORAGE_MISSING", tensor(storage(key="1"))),
    bad("storage_none", "an archive without storages", "STORAGE_MISSING", tensor(), {}),
    bad("storage_other_root", "a key with another zero", "STORAGE_MISSING", tensor(storage(key="00"))),
    bad("storage_short", "a storage of 5 of 6 numbers", "STORAGE_SIZE", tensor(), {"0": VALUES[:20]}),
    bad("storage_odd", "a storage a byte short", "STORAGE_SIZE", tensor(), {"0": VALUES[:-1]}),
    bad("storage_long", "a storage longer than declared", "STORAGE_SIZE", tensor(), {"0": VALUES * 2}),
    bad("storage_empty", "a storage without bytes", "STORAGE_SIZE", tensor(), {"0": b""}),
    bad("storage_huge", "a storage of 2^62 numbers", "STORAGE_SIZE", tensor(storage(count=HUGE))),
    bad("storage_wraps", "a storage whose bytes wrap to 24", "STORAGE_SIZE", tensor(storage(count=HUGE + 6))),
    bad("storage_double", "floats said to be doubles", "STORAGE_SIZE", tensor(storage("DoubleStorage"))),
    bad(
        "storage_conflict",
        "one storage of two types",
        "STORAGE_CONFLICT",
        row(tensor(), tensor(storage("IntStorage"))),
    ),
    bad(
        "storage_conflict_size",
        "one storage of two sizes",
        "STORAGE_CONFLICT",
        row(tensor(), tensor(storage(count=5))),
    ),
    *(
        bad(f"type_{kind.lower()}", f"a tensor of {kind}", "TENSOR_DTYPE", tensor(storage(f"{kind}Storage")))
        for kind in OTHER_TYPES.split()
    ),
    bad(
        "type_untyped",
        "an untyped storage",
        "TENSOR_DTYPE",
        row(text("storage"), name("torch.storage", "UntypedStorage"), text("0"), text("cpu"), b"K\x18")
        + b"Q",
    ),
    bad(
        "type_bool",
        "booleans that are 2",
        "TENSOR_BOOL",
        tensor(storage("BoolStorage")),
        {"0": b"\0\1\2\0\0\0"},
    ),
    *(
        bad(f"kind{what}", f"a tensor by {what}", "TENSOR_KIND", call(name("torch._utils", what), b"N"))
        for what in OTHER_TENSORS
    ),
]

WINDOW_CASES = [
    window("one_over", "one element too many", "RANGE", (7,), (1,)),
    window("offset", "an offset that pushes it out", "RANGE", (2, 3), (3, 1), offset=1),
    window("offset_far", "an offset of 2^62", "RANGE", (1,), (1,), offset=HUGE),
    window("offset_wraps", "an offset that wraps to 0 in bytes", "RANGE", (6,), (1,), offset=HUGE),
    window("offset_negative", "a negative offset", "RANGE", (2,), (1,), offset=-1),
    window("offset_empty", "an empty tensor outside its storage", "RANGE", (0,), (1,), offset=7),
    window("stride_far", "a stride out of the storage", "RANGE", (2, 3), (4, 1)),
    window("stride_huge", "a stride of 2^62", "RANGE", (2, 1), (HUGE, 1)),
    window("stride_negative", "a negative stride", "STRIDE", (6,), (-1,), offset=5),
    window("stride_few", "too few strides", "STRIDE", (2, 3), (3,)),
    window("stride_many", "too many strides", "STRIDE", (2, 3), (3, 1, 1)),
    window("size_negative", "a negative size", "SHAPE", (-1, 3), (3, 1)),
    window("size_negatives", "two negative sizes", "SHAPE", (-2, -3), (3, 1)),
    window("size_overflow", "a size whose product wraps to 0", "SHAPE", (1 << 33, 1 << 33), (1, 1)),
    window("size_empty_overflow", "an empty size that overflows", "SHAPE", (0, HUGE, HUGE), (1, 1, 1)),
    window("size_axes", "33 axes", "SHAPE", (1,) * 33, (1,) * 33),
    window("size_many_axes", "10 000 axes", "SHAPE", (1,) * 10_000, (1,) * 10_000),
    window("expanded", "one element, 2^40 times", "EXPANDED", (1 << 40,), (0,)),
    window("expanded_rows", "seven of six elements", "EXPANDED", (7, 1), (0, 1)),
    window("expanded_overlap", "overlapping rows", "EXPANDED", (5, 2), (1, 1)),
]


def made(label: str, title: str, *arguments: bytes) -> Case:
    return bad(f"made_{label}", title, "TENSOR_ARGUMENTS", call(REBUILD, *arguments))


SIZE, STRIDE, REST = integers((2, 3)), integers((3, 1)), (b"\x89", ORDERED)
ARGUMENT_CASES = [
    made("of_nothing", "a tensor of no arguments"),
    made("of_five", "a tensor of 5 arguments", storage(), b"K\0", SIZE, STRIDE, b"\x89"),
    made("of_seven", "a tensor with metadata", storage(), b"K\0", SIZE, STRIDE, *REST, mapping(neg=b"\x88")),
    made("of_list", "a tensor on a list", b"]", b"K\0", SIZE, STRIDE, *REST),
    made("of_tensor", "a tensor on a tensor", tensor(), b"K\0", SIZE, STRIDE, *REST),
    made("of_type", "a tensor on a type", name("torch", "FloatStorage"), b"K\0", SIZE, STRIDE, *REST),
    made("offset_text", "an offset that is text", storage(), text("0"), SIZE, STRIDE, *REST),
    made("offset_bool", "an offset that is true", storage(), b"\x88", SIZE, STRIDE, *REST),
    made("size_list", "a size in a list", storage(), b"K\0", b"](K\2K\3e", STRIDE, *REST),
    made("size_float", "a size of floats", storage(), b"K\0", row(b"G" + bytes(8)), integers((1,)), *REST),
    made("size_bool", "a size of booleans", storage(), b"K\0", row(b"\x88"), integers((1,)), *REST),
    made("stride_none", "a stride that is None", storage(), b"K\0", SIZE, b"N", *REST),
    bad(
        "parameter_of_number",
        "a Parameter of a number",
        "TENSOR_ARGUMENTS",
        call(name("torch._utils", "_rebuild_parameter"), integer(1), *REST),
    ),
    bad(
        "parameter_alone",
        "a Parameter without the rest",
        "TENSOR_ARGUMENTS",
        call(name("torch._utils", "_rebuild_parameter"), tensor()),
    ),
]

CASES = [*STORAGE_CASES, *WINDOW_CASES, *ARGUMENT_CASES]
