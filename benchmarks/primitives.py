"""Compare our scan, sort and scratch buffers with pyopencl's, on one device in one process.

    python -m benchmarks.primitives                      0.1, 1 and 16 million elements, on the default device
    python -m benchmarks.primitives --device gpu         on another device

The program needs mako, because pyopencl generates its scan and sort with it. Elements and keys have 32 bits.
Our code and pyopencl take turns, and the order changes from round to round. The table shows median times, and
the median of the ratios within a round. A time begins with the call and ends when the queue is empty. If the
results differ, the benchmark fails. pyopencl's scan and sort use its `MemoryPool`. Its sort uses the fastest
number of bits per pass on this device. "buffers" allocates the memory of a frame: eight scratch arrays that
are each filled once. Their sizes change by up to a quarter between frames. "held" is the memory that the
pools keep at the end.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.measure import keep, machine
from msb.cl import Device, exclusive_scan, open_device, sort_pairs

SIZES = (100_000, 1_000_000, 16_000_000)
BUFFERS = 8
BITS_A_PASS = (2, 3, 4)
Work = Callable[[], object]


class Peer:
    """pyopencl's queue and pool on our device, and its kernels."""

    def __init__(self, device: Device) -> None:
        import pyopencl as cl
        from pyopencl.algorithm import RadixSort
        from pyopencl.scan import ExclusiveScanKernel, GenericScanKernel
        from pyopencl.tools import ImmediateAllocator, MemoryPool

        ours = device.new_memory().queue
        self.queue = cl.CommandQueue(ours.context, ours.handle)
        self.pool = MemoryPool(ImmediateAllocator(self.queue))
        self.scan = ExclusiveScanKernel(ours.context, np.uint32, "a+b", neutral="0")
        self.wide_scan = GenericScanKernel(
            ours.context,
            np.uint64,
            arguments="__global uint *values, __global ulong *offsets",
            input_expr="values[i]",
            scan_expr="a+b",
            neutral="0",
            output_statement="offsets[i] = prev_item;",
        )
        self.sorts = {
            bits: RadixSort(
                ours.context,
                "__global uint *keys, __global uint *values",
                key_expr="keys[i]",
                sort_arg_names=["keys", "values"],
                bits_at_a_time=bits,
            )
            for bits in BITS_A_PASS
        }

    def array(self, values: np.ndarray) -> Any:
        """Return a pyopencl array with `values`, allocated from the pool."""
        from pyopencl.array import to_device

        return to_device(self.queue, values, allocator=self.pool)


class Pair(NamedTuple):
    """The same work in our code and in pyopencl. Both return comparable results."""

    name: str
    ours: Work
    theirs: Work
    compare: Callable[[], None]
    held: Callable[[], tuple[int, int]] | None = None


def scan_pair(device: Device, peer: Peer, count: int, dtype: type[np.unsignedinteger[Any]]) -> Pair:
    """Return the exclusive prefix sum of `count` numbers (uint32). The sums have the type `dtype`."""
    from pyopencl.array import empty

    values = np.random.default_rng(0).integers(0, 16, count, np.uint32)
    given, offsets = device.upload(values), device.allocate(count + 1, dtype)
    theirs_in, theirs_out = peer.array(values), empty(peer.queue, count, dtype, allocator=peer.pool)
    kernel = peer.scan if dtype is np.uint32 else peer.wide_scan

    def compare() -> None:
        np.testing.assert_array_equal(offsets.read()[:-1], theirs_out.get())

    return Pair(
        f"scan to {np.dtype(dtype)}",
        lambda: exclusive_scan(device, given, offsets),
        lambda: kernel(theirs_in, theirs_out, queue=peer.queue, allocator=peer.pool),
        compare,
    )


def sort_pair(device: Device, peer: Peer, count: int, bits: int) -> Pair | None:
    """Return the stable sort of `count` keys of `bits` bits with a payload, or None if the sort of pyopencl
    fails.

    On devices with many compute units, pyopencl's scan ends with a failed assertion for some sizes.
    """
    random = np.random.default_rng(1)
    keys = random.integers(0, 1 << bits, count, np.uint32)
    values = random.permutation(count).astype(np.uint32)
    given, payload = device.upload(keys), device.upload(values)
    theirs_keys, theirs_values = peer.array(keys), peer.array(values)
    last: dict[str, Any] = {}

    def theirs(digits: int) -> None:
        sort = peer.sorts[digits]
        last["theirs"] = sort(
            theirs_keys, theirs_values, queue=peer.queue, allocator=peer.pool, key_bits=bits
        )[0]

    def ours() -> None:
        last["ours"] = sort_pairs(device, given, payload, bits=bits)

    works = []
    for digits in BITS_A_PASS:  # compile, and fill the pool
        with contextlib.suppress(AssertionError):
            theirs(digits)
            works.append(digits)
    if not works:
        return None
    best = min(works, key=lambda digits: timed(peer.queue.finish, lambda: theirs(digits)))

    def compare() -> None:
        for own, other in zip(last["ours"], last["theirs"], strict=True):
            np.testing.assert_array_equal(own.read(), other.get())

    return Pair(f"sort by {bits} bits ({best} a pass)", ours, lambda: theirs(best), compare)


def buffers_pair(device: Device, peer: Peer, count: int) -> Pair:
    """Return the work of filling the scratch arrays of a frame, of about `count` uint32 each."""
    import pyopencl as cl

    memory = device.new_memory()
    sizes = {name: np.random.default_rng(2) for name in ("ours", "theirs")}
    zero = np.zeros(1, np.uint32)

    def wanted(name: str) -> int:
        return int(count * sizes[name].uniform(0.75, 1.25))

    def ours() -> None:
        for number in range(BUFFERS):
            memory.scratch(f"buffer {number}", wanted("ours"), np.uint32).fill(0)

    def theirs() -> None:
        frame = []
        for _ in range(BUFFERS):
            nbytes = 4 * wanted("theirs")
            frame.append(peer.pool.allocate(nbytes))
            cl.enqueue_fill_buffer(peer.queue, frame[-1], zero, 0, nbytes)

    before = peer.pool.managed_bytes
    return Pair(
        f"{BUFFERS} buffers",
        ours,
        theirs,
        lambda: None,
        lambda: (sum(memory.by_use().values()), peer.pool.managed_bytes - before),
    )


def timed(finish: Callable[[], object], work: Work) -> float:
    """Return the milliseconds until `work` and its queued commands have finished."""
    start = time.perf_counter()
    work()
    finish()
    return 1e3 * (time.perf_counter() - start)


def compare(device: Device, peer: Peer, pair: Pair, rounds: int) -> dict[str, Any]:
    """Return the times of both sides in milliseconds, after one warm-up round."""
    sides = (("ours", pair.ours, device.finish), ("theirs", pair.theirs, peer.queue.finish))
    times: dict[str, list[float]] = {"ours": [], "theirs": []}
    for number in range(rounds + 1):
        for name, work, finish in sides[:: 1 if number % 2 else -1]:
            took = timed(finish, work)
            if number:
                times[name].append(took)
    pair.compare()
    ratios = [theirs / ours for ours, theirs in zip(times["ours"], times["theirs"], strict=True)]
    row = {
        "name": pair.name,
        **{name: statistics.median(found) for name, found in times.items()},
        "ratio": statistics.median(ratios),
        "times": times,
    }
    return row if pair.held is None else {**row, "held": pair.held()}


def pairs(device: Device, peer: Peer, count: int) -> list[Callable[[], Pair | None]]:
    """Return a constructor for each pair. Thus only one pair is in memory at a time."""
    return [
        lambda: scan_pair(device, peer, count, np.uint32),
        lambda: scan_pair(device, peer, count, np.uint64),
        lambda: sort_pair(device, peer, count, 32),
        lambda: sort_pair(device, peer, count, 20),
        lambda: buffers_pair(device, peer, count),
    ]


def main() -> None:
    """Measure all sizes and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--device")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    record: dict[str, Any] = {
        "machine": machine("numpy", "pyopencl", "pocl-binary-distribution", "mako"),
        "sizes": {},
    }
    sys.stdout.reconfigure(line_buffering=True)
    print(", ".join(f"{key} {value}" for key, value in record["machine"].items()))
    with open_device(options.device) as device:
        record["device"] = str(device.record)
        print(f"{device.record}; median of {options.rounds} rounds")
        for count in options.sizes:
            print(f"\n{count:,} elements\n{'':<30}{'ours, ms':>10}{'pyopencl':>10}{'/ ours':>8}  held, MB")
            rows = record["sizes"][count] = []
            for make in pairs(device, peer := Peer(device), count):
                pair = make()
                if pair is None:
                    print("pyopencl's sort fails at this size")
                    continue
                row = compare(device, peer, pair, options.rounds)
                held = " / ".join(f"{nbytes / 1e6:,.0f}" for nbytes in row.get("held", ()))
                print(
                    f"{row['name']:<30}{row['ours']:>10.2f}{row['theirs']:>10.2f}{row['ratio']:>8.2f}  {held}"
                )
                rows.append(row)
                peer.pool.free_held()
    keep(record, options.json)


if __name__ == "__main__":
    main()
