"""Bad checkpoints: storages and tensors that contradict each other or the file, or that are unsupported."""

from msb.adapters.checkpoint.names import OTHER_TENSORS
from tests.adapters.assemble import (
    ORDERED,
    REBUILD,
    VALUES,
    Case,
    archive,
    call,
    integers,
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
    return bad(f"tensor_{label}", code, tensor(None, *shape, **more))


OTHER_TYPES = "ComplexFloat ComplexDouble QInt8 QUInt8 QInt32 QUInt4x2 QUInt2x4"

STORAGE_CASES = [
    bad("storage_missing", "DAMAGED", tensor(storage(key="1"))),
    bad("storage_short", "DAMAGED", tensor(), {"0": VALUES[:20]}),
    bad("storage_conflict", "HOSTILE", row(tensor(), tensor(storage("IntStorage")))),
    *(bad(f"type_{kind.lower()}", "FORM", tensor(storage(f"{kind}Storage"))) for kind in OTHER_TYPES.split()),
    bad(
        "type_untyped",
        "FORM",
        row(text("storage"), name("torch.storage", "UntypedStorage"), text("0"), text("cpu"), b"K\x18")
        + b"Q",
    ),
    bad("type_bool", "DAMAGED", tensor(storage("BoolStorage")), {"0": b"\0\1\2\0\0\0"}),
    *(bad(f"kind{what}", "FORM", call(name("torch._utils", what), b"N")) for what in OTHER_TENSORS),
]

WINDOW_CASES = [
    window("offset_far", "HOSTILE", (1,), (1,), offset=HUGE),
    window("stride_negative", "HOSTILE", (6,), (-1,), offset=5),
    window("size_many_axes", "HOSTILE", (1,) * 10_000, (1,) * 10_000),
    window("expanded", "FORM", (1 << 40,), (0,)),
]


def bad_call(label: str, *arguments: bytes) -> Case:
    return bad(f"made_{label}", "HOSTILE", call(REBUILD, *arguments))


SIZE, STRIDE, REST = integers((2, 3)), integers((3, 1)), (b"\x89", ORDERED)
ARGUMENT_CASES = [
    bad_call("of_list", b"]", b"K\0", SIZE, STRIDE, *REST),
    bad_call("offset_text", storage(), text("0"), SIZE, STRIDE, *REST),
    bad("parameter_alone", "HOSTILE", call(name("torch._utils", "_rebuild_parameter"), tensor())),
]

CASES = [*STORAGE_CASES, *WINDOW_CASES, *ARGUMENT_CASES]
