"""Device memory: copies, views, accounting, limits and release."""

import dataclasses
import gc
from pathlib import Path

import numpy as np
import pytest

from msb.cl import Device
from msb.errors import DeviceError
from tests.cl.conftest import KERNELS


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [(np.uint8, (0,)), (np.int32, (1,)), (np.uint64, (7, 3)), (np.float32, (0, 3)), (np.float64, (2, 3, 4))],
)
def test_upload_and_read_round_trip(device: Device, dtype: type, shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape), dtype=dtype).reshape(shape)
    buffer = device.upload(array, "test")
    assert buffer.shape == shape
    assert buffer.dtype == dtype
    assert buffer.nbytes == array.nbytes
    assert np.array_equal(buffer.read(), array)
    with buffer.mapped() as mapped:
        assert np.array_equal(mapped, array)
        assert not mapped.flags.writeable


@pytest.mark.parametrize("dtype", [bool, object, ">f4", "M8[s]", complex])
def test_unsupported_dtypes_are_rejected(device: Device, dtype: object) -> None:
    with pytest.raises(TypeError, match="native byte order"):
        device.upload(np.zeros(3, dtype))


def test_partial_reads_writes_and_copies(device: Device) -> None:
    buffer = device.allocate(10, np.uint32, "test")
    buffer.fill(7)
    buffer.write(np.array([1, 2], np.uint32), start=4)
    assert buffer.read().tolist() == [7, 7, 7, 7, 1, 2, 7, 7, 7, 7]
    assert buffer.read(start=5).tolist() == [2, 7, 7, 7, 7]
    out = np.zeros(3, np.uint32)
    assert buffer.read(out, start=3) is out
    assert out.tolist() == [7, 1, 2]
    larger = device.allocate(12, np.uint32, "test")
    larger.fill(0)
    larger.copy(buffer, start=2)
    assert larger.read().tolist() == [0, 0, *buffer.read().tolist()]
    for start in (3, -1):
        with pytest.raises(ValueError, match="elements"):
            larger.copy(buffer, start=start)
    with pytest.raises(TypeError, match="int32"):
        larger.copy(device.upload(np.zeros(2, np.int32)))
    for wrong, start in ((out, 8), (out, -1), (np.zeros(11, np.uint32), 0)):
        with pytest.raises(ValueError, match="elements"):
            buffer.read(wrong, start=start)
        with pytest.raises(ValueError, match="elements"):
            buffer.write(wrong, start=start)
    for other in (np.zeros(3, np.int32), np.zeros((3, 2), np.uint32)[:, 0]):
        with pytest.raises(TypeError, match="C-contiguous array of uint32"):
            buffer.read(other)


def test_views_share_memory(device: Device) -> None:
    floats = device.upload(np.array([0.0, 1.0, 2.0], np.float32))
    bits = floats.view((3,), np.uint32)
    assert bits.read().tolist() == [0, 0x3F800000, 0x40000000]
    with pytest.raises(ValueError, match="16 bytes exceed the 12"):
        floats.view(4, np.uint32)
    floats.release()
    with pytest.raises(DeviceError, match="released"):
        bits.read()


@pytest.mark.slow
def test_memory_accounts_for_every_byte(fresh: Device) -> None:
    assert fresh.memory() == {}
    positions = fresh.upload(np.zeros((5, 3), np.float32), "positions")
    more = fresh.upload(np.zeros(2, np.float32), "positions")
    keys = fresh.allocate(10, np.uint64, "keys")
    assert fresh.memory() == {"keys": 80, "positions": 68}
    more.release()
    more.release()
    assert fresh.memory() == {"keys": 80, "positions": 60}
    view = positions.view(3, np.float32)
    del positions
    gc.collect()
    assert fresh.memory() == {"keys": 80, "positions": 60}
    del view
    gc.collect()
    assert fresh.memory() == {"keys": 80}
    keys.release()
    assert fresh.memory() == {}


def test_scratch_pool_reuses_grows_and_releases(fresh: Device) -> None:
    first = fresh.scratch("keys", 1000, np.uint32)
    first.fill(3)
    held = fresh.memory()["keys"]
    assert 4000 <= held <= 4500  # at most an eighth larger
    again = fresh.scratch("keys", (10, 10), np.uint32)
    assert again.shape == (10, 10)
    assert (again.read() == 3).all()
    assert fresh.scratch("keys", 0, np.uint32).size == 0
    assert fresh.memory() == {"keys": held}
    grown = fresh.scratch("keys", 100_000, np.uint32)
    assert fresh.memory()["keys"] >= grown.nbytes == 400_000
    with pytest.raises(DeviceError, match="keys was released") as error:
        first.read()
    assert error.value.code == "DEVICE_CLOSED"
    assert fresh.scratch("values", 1, np.uint8) is not None
    assert set(fresh.memory()) == {"keys", "values"}
    fresh.release_scratch("key")
    assert list(fresh.memory()) == ["values"]
    with pytest.raises(DeviceError):
        grown.read()
    fresh.scratch("keys", 50).fill(3)
    fresh.finish()


def test_allocations_beyond_the_device_memory_fail(fresh: Device) -> None:
    # A device with 1 MiB of memory, and at most 64 KiB per buffer.
    fresh._queue.record = dataclasses.replace(fresh.record, global_memory=2**20, max_allocation=2**16)
    held = [fresh.allocate(2**16, np.uint8, "positions") for _ in range(15)]
    for make in (
        lambda: fresh.allocate(2**16 + 1, np.uint8, "too much at once"),
        lambda: fresh.upload(np.zeros(2**16 + 1, np.uint8), "too much at once"),
        lambda: fresh.scratch("too much at once", 2**16 + 1),
    ):
        with pytest.raises(DeviceError, match="too much at once") as error:
            make()
        assert error.value.code == "DEVICE_MEMORY"
        assert "0.9 MiB in use" in error.value.message
    last = fresh.scratch("last", 60_000)  # rounding up in the pool must not exceed the limit
    with pytest.raises(DeviceError, match="do not fit"):
        fresh.allocate(2**13, np.uint8, "too much in all")
    assert len(held) == 15
    assert last.nbytes == 60_000
    with pytest.raises(DeviceError, match="last do not fit"):
        fresh.scratch("last", 2**16 + 1)
    fresh.scratch("last", 60_000).fill(1)  # a failed allocation leaves no trace


def test_closed_device_rejects_every_use(fresh: Device) -> None:
    device = fresh
    buffer = device.upload(np.zeros(3, np.float32))
    kernel = device.program("simple", {"OFFSET": 0}, KERNELS).scaled
    device.close()
    device.close()
    assert device.memory() == {}
    for use in (
        lambda: buffer.read(),
        lambda: buffer.write(np.zeros(3, np.float32)),
        lambda: buffer.fill(0),
        lambda: buffer.handle,
        lambda: device.upload(np.zeros(3, np.float32)),
        lambda: device.allocate(3),
        lambda: device.scratch("keys", 3),
        lambda: device.program("simple", {"OFFSET": 0}, KERNELS),
        lambda: kernel(3, 1, buffer, buffer, np.uint32(3)),
        lambda: device.finish(),
    ):
        with pytest.raises(DeviceError) as error:
            use()
        assert error.value.code == "DEVICE_CLOSED"


def address(device: Device, array: np.ndarray) -> bool:
    """Return whether the device uses the memory of the array."""
    with device.upload(array, "shared").mapped() as mapped:
        return mapped.ctypes.data == array.ctypes.data


def test_pocl_shares_constant_arrays(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "array.bin"
    np.arange(5000, dtype=np.float32).tofile(path)
    mapped = np.memmap(path, np.float32, "r")
    pocl = device.record.selector.startswith("pocl")
    assert address(device, mapped) == pocl
    assert address(device, mapped[16:]) == pocl
    assert not address(device, mapped[1:])  # not aligned
    changeable = np.memmap(path, np.float32, "r+")
    assert not address(device, changeable)
    hidden = changeable[:]
    hidden.flags.writeable = False
    assert not address(device, hidden)
    with device.upload(mapped).mapped() as view:
        assert not address(device, view)  # invalid after the block
