"""Exclusive prefix sum on the device."""

from collections.abc import Mapping

import numpy as np

from msb.cl.buffers import Buffer
from msb.cl.device import Device
from msb.cl.kernel_text import Define
from msb.cl.programs import Program

# Maximum number of elements of a scan or sort; positions are 32-bit numbers.
MOST = 2**31
# Minimum number of elements per work-item. With fewer elements, starting a second work-item costs more than
# it saves.
_SMALLEST_CHUNK = 4096
# Number of chunks per compute unit. With several chunks, idle units can take over work of a delayed unit.
_CHUNKS_PER_UNIT = 4
# Consecutive elements per work-item on a GPU.
_ITEMS = 8
# Maximum number of tile sums that each work-group of a GPU adds up, 16 per work-item. A larger number of sums
# needs another launch.
_MOST_SUMS = 4096
# Maximum size of a work-group on a GPU.
_LARGEST_GROUP = 256
_OPENCL_NAMES = {np.dtype(np.uint32): "uint", np.dtype(np.uint64): "ulong"}


def exclusive_scan(device: Device, values: Buffer, offsets: Buffer, count: int | None = None) -> None:
    """Queue ``offsets[i] = sum(values[:i])`` for i = 0 .. count. The last offset is the total.

    Parameters
    ----------
    device : Device
    values : Buffer of uint32
    offsets : Buffer of uint32 or uint64
        The buffer has at least count + 1 elements. Sums wrap modulo 2^32 or 2^64. A uint32 `offsets` buffer
        may share the memory of `values`.
    count : int, optional
        Number of elements, at most 2^31. Default: all elements of `values`.

    Raises
    ------
    DeviceError
        `DEVICE_MEMORY`, `DEVICE_BUILD`, `DEVICE_COMMAND`.
    """
    count = check_count(count, values)
    if values.dtype != np.uint32 or offsets.dtype not in _OPENCL_NAMES or offsets.size < count + 1:
        raise TypeError(f"a scan of {count} uint32 values needs count + 1 offsets of uint32 or uint64")
    if count == 0:
        offsets.view(1, offsets.dtype).fill(0)
    elif device.style == "cpu":
        _scan_cpu(device, values, offsets, count)
    else:
        _scan_gpu(device, values, offsets, count, level=0)


def _scan_cpu(device: Device, values: Buffer, offsets: Buffer, count: int) -> None:
    # Sum each chunk of elements and scan the sums. Scan each chunk of elements, starting from the chunk's
    # offset.
    program = device.program("scan_cpu", {"SUM": _OPENCL_NAMES[offsets.dtype]})
    chunk, chunks = chunks_of(device, count)
    starts = device.scratch("scan starts", chunks, offsets.dtype)
    if chunks > 1:
        program.sum_chunks(chunks, 1, values, starts, np.uint32(count), np.uint32(chunk))
        program.scan_starts(1, 1, starts, np.uint32(chunks))
    sizes = np.uint32(count), np.uint32(chunk), np.uint32(chunks)
    program.scan_chunks(chunks, 1, values, starts, offsets, *sizes)


def _scan_gpu(device: Device, values: Buffer, offsets: Buffer, count: int, level: int) -> None:
    program, group = build_grouped_program(
        device,
        "scan_gpu",
        {"VALUE": _OPENCL_NAMES[values.dtype], "SUM": _OPENCL_NAMES[offsets.dtype], "ITEMS": _ITEMS},
    )
    # Sum each tile. Scan the tile sums recursively if there are too many for one launch. Scan each tile of
    # elements, starting from the tile's offset.
    tiles = -(-count // (group * _ITEMS))
    sums = device.scratch(f"scan sums {level}", tiles + 1, offsets.dtype)
    if tiles > 1:
        program.sum_tiles(tiles * group, group, values, sums, np.uint32(count))
    if tiles > _MOST_SUMS:
        _scan_gpu(device, sums, sums, tiles, level + 1)
    sizes = np.uint32(count), np.uint32(tiles > _MOST_SUMS)
    program.scan_tiles(tiles * group, group, values, sums, offsets, *sizes)


def check_count(count: int | None, array: Buffer) -> int:
    """Check and return the number of elements; by default, all elements of `array`."""
    count = array.size if count is None else count
    if not 0 <= count <= min(array.size, MOST):
        raise ValueError(f"{count} elements requested from an array of {array.size}; the limit is {MOST}")
    return count


def chunks_of(device: Device, count: int) -> tuple[int, int]:
    """Return the length and the number of the contiguous chunks into which a CPU divides `count` elements."""
    limit = min(-(-count // _SMALLEST_CHUNK), _CHUNKS_PER_UNIT * device.record.compute_units)
    chunk = -(-count // max(limit, 1))
    return chunk, -(-count // max(chunk, 1))


def build_grouped_program(device: Device, name: str, defines: Mapping[str, Define]) -> tuple[Program, int]:
    """Return a program in GPU style, and the size of its work-groups. The program gets this size as the
    define GROUP.

    The size is the largest power of two, up to 256, that the device and every built kernel allow.
    """
    most = min(_LARGEST_GROUP, device.record.max_work_group)
    while True:
        group = 1 << (most.bit_length() - 1)
        program = device.program(name, {**defines, "GROUP": group})
        if group <= program.max_work_group:
            return program, group
        most = program.max_work_group
