"""Valid checkpoints of torch and of the methods; their tensors are views of the mapped file."""

import json
import mmap
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fuzz import readers
from msb.adapters.checkpoint import BFloat16Array, read_checkpoint
from msb.errors import CheckpointError
from tests.adapters.assemble import (
    GOOD,
    ORDERED,
    VALUES,
    archive,
    legacy,
    mapping,
    name,
    program,
    row,
    storage,
    tensor,
)
from tests.adapters.describe import assert_same_arrays, describe
from tests.corpus.forge import FULL32, Entry, write_sparse, zip64

GOLDEN = Path(__file__).parent.parent / "golden" / "checkpoints"
FILES = sorted(path.name for path in GOLDEN.glob("*.pt"))

# --- files of torch 2.13 (tests/adapters/torch_samples.py)


@pytest.mark.parametrize("file", FILES)
def test_files_of_torch_have_the_expected_content(file: str) -> None:
    sample = file.rpartition("_")[0]
    expected = json.loads((GOLDEN / "expected.json").read_text())[sample]
    arrays: list[np.ndarray] = []
    assert describe(read_checkpoint(GOLDEN / file), arrays) == expected
    with np.load(GOLDEN / "expected.npz") as kept:
        assert_same_arrays(arrays, [kept[f"{sample}/{i}"] for i in range(len(arrays))])


# --- files of the methods (test_golden_exports.py compares their tensors)


@pytest.mark.parametrize(
    ("pattern", "least"),
    [
        ("mesh_splatting/*/checkpoint*/**/point_cloud_state_dict.pt", 4),
        ("triangle_splatting/*/checkpoint/**/*.pt", 8),
        ("two_dts/*/checkpoint/ckpt/*.ckpt", 3),
        ("diffsoup/*/checkpoint/final_params.pt", 3),
    ],
)
def test_files_of_the_methods_are_read_whole(shared: Path, pattern: str, least: int) -> None:
    paths = sorted((shared / "golden").glob(pattern))
    if not paths:
        pytest.skip(f"the shared data folder has no {pattern}")
    assert len(paths) >= least
    for path in paths:
        readers.checkpoint(path)


@pytest.mark.parametrize("make", [archive, legacy])
def test_the_templates_of_bad_checkpoints_are_valid(make: Callable[[], bytes], tmp_path: Path) -> None:
    (tmp_path / "good.pt").write_bytes(make())
    value = read_checkpoint(tmp_path / "good.pt")
    assert list(value) == ["w"]
    np.testing.assert_array_equal(value["w"], np.arange(1, 7, dtype=np.float32).reshape(2, 3))


def test_the_byte_at_fault_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(archive(GOOD.replace(b"OrderedDict", b"OrderedDict_")))
    with pytest.raises(CheckpointError, match="CHECKPOINT_HOSTILE") as caught:
        read_checkpoint(tmp_path / "a.pt")
    member, _, at = (caught.value.pointer or "").split()
    assert member == "data.pkl"
    assert GOOD[int(at) :].startswith(b"ccollections\n")


def mapping_below(array: np.ndarray) -> object:
    """Return the object whose memory an array uses."""
    below: object = array
    while isinstance(below, np.ndarray | memoryview):
        below = below.base if isinstance(below, np.ndarray) else below.obj
    return below


@pytest.mark.parametrize("file", ["windows_zip2.pt", "windows_legacy2.pt"])
def test_arrays_are_read_only_views_on_one_mapping(file: str) -> None:
    value = read_checkpoint(GOLDEN / file)
    arrays = [item.bits if isinstance(item, BFloat16Array) else item for item in value.values()]
    below = {id(mapping_below(array)) for array in arrays}
    assert len(below) == 1
    assert isinstance(mapping_below(arrays[0]), mmap.mmap)
    for array in arrays:
        assert not array.flags.writeable
        assert not array.flags.owndata
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        with pytest.raises(ValueError, match="cannot set WRITEABLE"):
            array.flags.writeable = True


@pytest.mark.parametrize("file", ["shared_zip2.pt", "shared_legacy2.pt"])
def test_shared_storages_are_shared(file: str) -> None:
    whole, again, part, table, inner = read_checkpoint(GOLDEN / file)
    assert all(np.shares_memory(whole, other) for other in (again, part, table, inner["again"]))
    assert part.shape == (6,)


def test_the_mapping_outlives_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    path.write_bytes(archive())
    value = read_checkpoint(path)
    path.unlink()
    assert value["w"].sum() == 21


def wide_entry(member: str, content: bytes, size: int, at: int) -> Entry:
    """Return a member as torch writes it for more than 4 GiB."""
    wide = (*((size, size) if size >= FULL32 else ()), *((at,) if at >= FULL32 else ()))
    flags = {"flags": 0x808 if size else 0x800, "crc": 0, "extra": zip64(*wide) if wide else b""}
    short = {"size": min(size, FULL32), "packed": min(size, FULL32), "offset": min(at, FULL32)}
    local = {"extra": zip64(*((size, 0, *wide[2:]) if size >= FULL32 else wide))} if wide else {}
    after = struct.pack("<4sI2Q" if wide else "<4sI2I", b"PK\x07\x08", 0, size, size) if size else b""
    return Entry(member, b"", both=flags, central=short, local=local, after=after)


def test_storages_beyond_4_gib(tmp_path: Path) -> None:
    """Torch 2.13 writes the same headers. The file is sparse."""
    count = (1 << 32) + 100
    big = tensor(storage("ByteStorage", "1", count), (count,), (1,))
    empty = tensor(storage(key="2", count=0), (0,), (1,))
    pickle = program(mapping(first=tensor(), big=big, empty=empty, last=tensor(storage(key="3"))))
    parts = [("data.pkl", pickle, 0), ("data/0", VALUES, 0), ("data/1", b"", count)]
    parts += [("data/2", b"", 0), ("data/3", VALUES, 0), ("version", b"3\n", 0)]
    members = [(f"archive/{member}", content, hole) for member, content, hole in parts]
    write_sparse(tmp_path / "big.pt", members, wide_entry)
    value = read_checkpoint(tmp_path / "big.pt")
    assert value["big"].shape == (count,)
    assert value["big"][-1] == 0
    assert value["empty"].shape == (0,)
    np.testing.assert_array_equal(value["last"], value["first"])


def test_bfloat16_widens_exactly(tmp_path: Path) -> None:
    bits = struct.pack("<6H", 0x3F80, 0xC000, 0x0001, 0x7F80, 0x7FC0, 0x8000)
    pickle = program(tensor(storage("BFloat16Storage")))
    (tmp_path / "a.pt").write_bytes(archive(pickle, {"0": bits}))
    value = read_checkpoint(tmp_path / "a.pt")
    assert isinstance(value, BFloat16Array)
    assert value.shape == (2, 3)
    assert value.bits.dtype == np.uint16
    wide = value.to_float32()
    assert wide.dtype == np.float32
    assert wide.flags.writeable
    np.testing.assert_array_equal(wide, [[1, -2, 2.0**-133], [np.inf, np.nan, -0.0]])


@pytest.mark.parametrize("version", [b"2", b"3\n", b"10\n"])
@pytest.mark.parametrize("byteorder", [b"little", b"little\n", None])
def test_versions_and_byte_orders(version: bytes, byteorder: bytes | None, tmp_path: Path) -> None:
    (tmp_path / "a.pt").write_bytes(archive(version=version, byteorder=byteorder))
    assert read_checkpoint(tmp_path / "a.pt")["w"].shape == (2, 3)


def test_numpy_1_names_and_attributes_of_an_ordered_dict(tmp_path: Path) -> None:
    scalar = name("numpy.core.multiarray", "scalar")
    kind = name("numpy", "dtype") + row(b"X\x02\0\0\0f8", b"\x89", b"\x88") + b"R"
    value = scalar + row(kind, b"C\x08" + struct.pack("<d", 2.5)) + b"R"
    attributed = ORDERED + b"}" + b"X\x09\0\0\0_metadata" + ORDERED + b"sb"
    (tmp_path / "a.pt").write_bytes(archive(program(mapping(s=value, d=attributed), protocol=3)))
    assert read_checkpoint(tmp_path / "a.pt") == {"s": 2.5, "d": {}}


def test_strides_of_axes_of_length_one_do_not_matter(tmp_path: Path) -> None:
    odd = tensor(None, (1, 6, 1), (1 << 62, 1, 12345))
    (tmp_path / "a.pt").write_bytes(legacy(program(odd)))
    assert read_checkpoint(tmp_path / "a.pt").tolist() == [[[1], [2], [3], [4], [5], [6]]]
