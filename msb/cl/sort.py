"""Stable radix sort of keys with values, on the device."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from msb.cl.buffers import Buffer
from msb.cl.device import Device
from msb.cl.kernel_text import Define
from msb.cl.programs import Program
from msb.cl.scan import build_grouped_program, check_count, chunks_of, exclusive_scan

# Consecutive elements of a sort per work-item on a GPU.
_ITEMS = 8
# Maximum number of key bits per pass. The first-level cache of a CPU supports 256 write streams. Passes of up
# to 8 bits therefore take equal time, but passes of 9 bits take twice as long. A GPU reads the data once per
# pass. Each work-group sorts its tile by 4 bits at a time in local memory.
_DIGIT_BITS = 8
_KEYS = {np.dtype(np.uint32): "uint", np.dtype(np.uint64): "ulong"}


class _Pass(NamedTuple):
    """The data for a sorting pass: the program, its sizes, the kernel arguments between count and shift, and
    the number of parts.
    """

    program: Program
    global_size: int
    local_size: int
    sizes: tuple[np.uint32, ...]
    parts: int


def sort_pairs(
    device: Device,
    keys: Buffer,
    values: Buffer | None = None,
    *,
    count: int | None = None,
    bits: int | None = None,
    name: str = "sort",
) -> tuple[Buffer, Buffer]:
    """Queue a stable sort of keys with one value each, in ascending order. Return sorted keys and values.

    Parameters
    ----------
    device : Device
    keys : Buffer of uint32 or uint64
        The keys. Non-negative floats can be sorted by their bits (`Buffer.view`).
    values : Buffer of uint32, optional
        The values to sort with the keys; by default 0, 1, 2 ..., so that the sorted values are the
        permutation.
    count : int, optional
        Number of leading elements to sort, at most 2^31. Default: all elements.
    bits : int, optional
        Sort by the lowest `bits` bits of a key. Default: all bits. With fewer bits the sort needs fewer
        passes over the data.
    name : str
        Name of the returned buffers. The returned buffers belong to the pool and stay valid until the next
        sort with this name. The function does not change the given buffers.

    Returns
    -------
    keys, values : Buffer
        (count,) with the dtype of `keys`, and (count,) uint32.

    Raises
    ------
    DeviceError
        `DEVICE_MEMORY`, `DEVICE_BUILD`, `DEVICE_COMMAND`.
    """
    count = check_count(count, keys)
    if keys.dtype not in _KEYS or (values and (values.dtype != np.uint32 or values.size < count)):
        raise TypeError(f"keys must be uint32 or uint64, and values {count} uint32")
    width = keys.dtype.itemsize * 8
    bits = width if bits is None else bits
    if not 0 <= bits <= width:
        raise ValueError(f"cannot sort by {bits} bits of {width}")

    passes = max(1, -(-bits // _DIGIT_BITS))
    digit = max(1, -(-bits // passes))
    key = _KEYS[keys.dtype]
    if device.style == "cpu":
        layout = _plan_cpu_pass(device, key, count)
    else:
        layout = _plan_gpu_pass(device, key, count, 1 << digit)
    places = device.scratch(f"{name} places", (layout.parts << digit) + 1, np.uint32)
    source = keys, values if values is not None else keys
    # Each pass counts the digits of every part, scans the counts to positions, and moves the pairs of key
    # and value.
    for number in range(passes):
        target = (
            device.scratch(f"{name} keys {number % 2}", count, keys.dtype),
            device.scratch(f"{name} values {number % 2}", count, np.uint32),
        )
        shift = number * digit
        mask = (1 << max(0, min(digit, bits - shift))) - 1
        head = *layout.sizes, np.uint32(shift), np.uint32(mask)
        launch: Callable[..., object] = layout.program.count_digits
        launch(layout.global_size, layout.local_size, source[0], places, *head)
        exclusive_scan(device, places, places, layout.parts * (mask + 1))
        numbered = np.uint32(values is None and number == 0)
        launch = layout.program.move_pairs
        launch(layout.global_size, layout.local_size, *source, *target, places, *head, numbered)
        source = target
    return source


def _plan_cpu_pass(device: Device, key: str, count: int) -> _Pass:
    chunk, chunks = chunks_of(device, count)
    program = device.program("radix_cpu", {"KEY": key, "DIGITS": 1 << _DIGIT_BITS})
    return _Pass(program, chunks, 1, (np.uint32(count), np.uint32(chunk), np.uint32(chunks)), chunks)


def _plan_gpu_pass(device: Device, key: str, count: int, digits: int) -> _Pass:
    defines: dict[str, Define] = {"KEY": key, "DIGITS": digits, "ITEMS": _ITEMS}
    program, group = build_grouped_program(device, "radix_gpu", defines)
    tiles = -(-count // (group * _ITEMS))
    return _Pass(program, tiles * group, group, (np.uint32(count), np.uint32(tiles)), tiles)
