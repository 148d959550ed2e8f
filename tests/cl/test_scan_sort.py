"""Prefix sum and radix sort compared with NumPy, in both styles of kernels."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from msb.cl import Device
from msb.cl.scan import MOST, exclusive_scan
from msb.cl.sort import sort_pairs
from tests.cl.conftest import KERNELS, open_styled

TILE = 2048
EDGES = [0, 1, 2, 255, 256, 257, TILE - 1, TILE, TILE + 1, 4095, 4096, 4097, 2 * 4096 + 1, 50_000]
CALM = settings(max_examples=20, derandomize=True)


def expect_scanned(device: Device, values: NDArray[np.uint32], dtype: type) -> None:
    """Scan on the device and compare with NumPy's sums."""
    offsets = device.allocate(len(values) + 1, dtype)
    exclusive_scan(device, device.upload(values), offsets)
    assert np.array_equal(offsets.read(), prefix(values, dtype))


def prefix(values: NDArray[np.uint32], dtype: type) -> NDArray[np.uint64]:
    return np.cumsum(np.append(np.uint64(0), values), dtype=np.uint64).astype(dtype)


@pytest.mark.slow
@pytest.mark.parametrize("count", EDGES)
@pytest.mark.parametrize("dtype", [np.uint32, np.uint64])
def test_scan_of_edge_sizes(styled: Device, count: int, dtype: type) -> None:
    expect_scanned(styled, np.random.default_rng(count).integers(0, 2**32, count, np.uint32), dtype)


@pytest.mark.slow
def test_scan_over_three_levels(styled: Device) -> None:
    values = np.random.default_rng(0).integers(0, 100, TILE * TILE + 5, np.uint32)
    expect_scanned(styled, values, np.uint64)


@CALM
@given(st.integers(0, 20_000), st.integers(0, 2**32 - 1), st.integers(0, 2**31))
def test_scan_in_place(styled: Device, count: int, high: int, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, high, count + 1, np.uint32, endpoint=True)
    buffer = styled.allocate(count + 1, np.uint32)
    buffer.write(values)
    exclusive_scan(styled, buffer, buffer, count)
    assert np.array_equal(buffer.read(), prefix(values[:count], np.uint32))


def test_scan_rejects_wrong_arguments(device: Device) -> None:
    values, offsets = device.allocate(4, np.uint32), device.allocate(4, np.uint32)
    with pytest.raises(TypeError, match=r"count \+ 1"):
        exclusive_scan(device, values, offsets)
    with pytest.raises(TypeError, match="uint32"):
        exclusive_scan(device, device.allocate(4, np.int32), offsets, 3)
    with pytest.raises(TypeError, match="uint64"):
        exclusive_scan(device, values, device.allocate(5, np.float32))
    for count in (-1, 5, MOST + 1):
        with pytest.raises(ValueError, match="elements"):
            exclusive_scan(device, values, offsets, count)


def expect_sorted(
    device: Device,
    keys: NDArray[np.uint32] | NDArray[np.uint64],
    values: NDArray[np.uint32] | None,
    bits: int | None = None,
) -> None:
    """Sort on the device and compare with NumPy's stable sort of the lowest bits."""
    width = keys.dtype.itemsize * 8
    mask = keys.dtype.type(2 ** (width if bits is None else bits) - 1)
    order = np.argsort(keys & mask, kind="stable")
    given_keys = device.upload(keys)
    given_values = None if values is None else device.upload(values)
    got_keys, got_values = sort_pairs(device, given_keys, given_values, bits=bits)
    assert np.array_equal(got_keys.read(), keys[order])
    assert np.array_equal(got_values.read(), order if values is None else values[order])
    assert np.array_equal(given_keys.read(), keys)
    assert given_values is None or np.array_equal(given_values.read(), values)


@pytest.mark.slow
@pytest.mark.parametrize("count", EDGES)
@pytest.mark.parametrize("dtype", [np.uint32, np.uint64])
def test_sort_of_edge_sizes(styled: Device, count: int, dtype: type) -> None:
    random = np.random.default_rng(count)
    keys = random.integers(0, np.iinfo(dtype).max, count, dtype, endpoint=True)
    expect_sorted(styled, keys, random.integers(0, 2**32, count, np.uint32))
    expect_sorted(styled, keys, None)


@CALM
@given(
    st.integers(0, 12_000),
    st.sampled_from([np.uint32, np.uint64]),
    st.integers(0, 64),
    st.integers(0, 64),
    st.booleans(),
    st.integers(0, 2**31),
)
def test_sort_is_stable_for_any_bits(
    styled: Device, count: int, dtype: type, bits: int, filled: int, with_values: bool, seed: int
) -> None:
    """Only the lowest `filled` bits of the keys are random. A small `filled` gives many equal keys. A
    `filled` above `bits` tests that the sort ignores the upper bits.
    """
    width = np.dtype(dtype).itemsize * 8
    bits, filled = min(bits, width), min(filled, width)
    random = np.random.default_rng(seed)
    keys = random.integers(0, 2**filled - 1, count, dtype, endpoint=True)
    values = random.integers(0, 2**32, count, np.uint32) if with_values else None
    expect_sorted(styled, keys, values, bits)


def test_positive_floats_sort_by_their_bits(styled: Device) -> None:
    depth = np.random.default_rng(5).exponential(3, 10_000).astype(np.float32)
    depth[:4] = 0, np.inf, 1e-40, 3e38
    buffer = styled.upload(depth)
    _, order = sort_pairs(styled, buffer.view(buffer.shape, np.uint32))
    assert np.array_equal(order.read(), np.argsort(depth, kind="stable"))


def test_sort_of_the_first_elements(styled: Device) -> None:
    keys = np.arange(100, dtype=np.uint32)[::-1].copy()
    got_keys, got_values = sort_pairs(styled, styled.upload(keys), count=40)
    assert got_keys.read().tolist() == list(range(60, 100))
    assert got_values.read().tolist() == list(range(39, -1, -1))


def test_sort_rejects_wrong_arguments(device: Device) -> None:
    keys = device.allocate(4, np.uint32)
    with pytest.raises(TypeError, match="uint32 or uint64"):
        sort_pairs(device, device.allocate(4, np.float32))
    with pytest.raises(TypeError, match="values 4 uint32"):
        sort_pairs(device, keys, device.allocate(3, np.uint32))
    for bits in (-1, 33):
        with pytest.raises(ValueError, match="bits of 32"):
            sort_pairs(device, keys, bits=bits)
    with pytest.raises(ValueError, match="elements"):
        sort_pairs(device, keys, count=5)


def test_many_tile_sums_are_scanned_recursively(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU, recursion starts at more than eight million elements."""
    monkeypatch.setattr("msb.cl.scan._MOST_SUMS", 2)
    values = np.random.default_rng(3).integers(0, 2**32, 50_000, np.uint32)
    with open_styled("gpu") as device:
        for dtype in (np.uint32, np.uint64):
            expect_scanned(device, values, dtype)


@pytest.mark.slow
@pytest.mark.parametrize("most", [64, 100, 128])
@pytest.mark.parametrize("who", ["device", "kernel"])
def test_work_groups_are_as_large_as_device_and_kernels_allow(who: str, most: int) -> None:
    with open_styled("gpu") as device:
        allowed = device.program("simple", {"OFFSET": 0}, KERNELS).max_work_group
        device._queue.record = replace(device.record, max_work_group=most)
        if who == "device":  # otherwise only the built kernels report the limit
            device.record = device._queue.record
        random = np.random.default_rng(most)
        expect_scanned(device, random.integers(0, 9, 5000, np.uint32), np.uint64)
        expect_sorted(device, random.integers(0, 2**32, 3000, np.uint32), None)
        groups = {dict(key[2])["GROUP"] for key in device._programs if key[0] != KERNELS}
    assert min(groups) == 1 << (min(most, allowed).bit_length() - 1)
    assert (max(groups) > most) == (who == "kernel")
