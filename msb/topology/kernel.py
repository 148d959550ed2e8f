"""The mesh audit by OpenCL kernels for a CPU.

`findings.find_by_numpy` is the readable version of this module.

1. Corners are sorted into blocks of vertices. A block fits into the cache of a processor core. A corner
   stores the other two vertices of its face.
2. Each vertex of a block is visited together with its faces. Common neighbour vertices of two faces
   determine edges, fans, duplicates and the boundary. A kernel compares all pairs of faces at a vertex
   (audit_small.cl). If a vertex has many faces, another kernel sorts the faces instead (audit_large.cl).
3. Each visit adds pairs of connected faces to lists. Uniting the pairs gives the components. The root of a
   component is its lowest face (audit_pairs.cl).

docs/audit_speed.md gives reasons and measurements.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from msb.cl import Buffer, Device, Program
from msb.topology.findings import SAMPLES, Findings
from msb.topology.tally import Totals, add_up, tally_dtype

# Kinds of face pairs in audit_pairs.cl: two faces at a two-face edge, at a crowded edge, and along a rim.
TWO_FACE, CROWDED, RIM = range(3)


@dataclass(frozen=True)
class Sizes:
    """Sizes that affect the time and memory of the kernels, but not the results.

    Attributes
    ----------
    block_corners : int
        Average number of corners in a block of vertices. The default takes 200 KB, so that a second-level
        cache holds two blocks.
    most_blocks : int
        Maximum number of blocks. Each block is written as a separate stream.
    large_block : int
        Maximum number of corners of a block that a work-item copies to sort the block. Larger blocks are
        sorted in place. The limit is at least 1/16 of the corners per worker.
    rounds : int
        Number of rounds. Each round processes some of the blocks in the same memory. If a block of vertices
        exceeds `large_block`, there is one more round.
    most_compared : int
        Maximum number of faces of a vertex that are compared pairwise. The number is a multiple of 8, up to
        32.
    chunk_pairs : int
        Number of face pairs in a chunk of the list. The number is more than four times `most_compared`.
    valences : int
        Length of the valence table. Larger valences are listed individually.
    """

    block_corners: int = 12288
    most_blocks: int = 4096
    large_block: int = 1 << 16
    rounds: int = 2
    most_compared: int = 32
    chunk_pairs: int = 4096
    valences: int = 256


def find_by_kernels(
    points: NDArray[Any],
    faces: NDArray[np.int32],
    device: Device,
    *,
    workers: int | None = None,
    sizes: Sizes | None = None,
) -> Findings:
    """Return the findings of the audit of floating `points` (V, 3) and int32 `faces` (F, 3).

    The device must support double precision. The argument `workers` is the number of work-items, by default
    one per compute unit. The kernels take O(V + F) time if vertices have few faces, and O(V + F log F) for
    any mesh. The kernels use about 45 bytes of device memory per face, which are released at the end.
    """
    run = _Run(points, faces, device, workers or device.record.compute_units, sizes or Sizes())
    try:
        return run.findings()
    finally:
        run.release()


class _Run:
    """A running audit: its buffers, and its stages in order."""

    def __init__(
        self, points: NDArray[Any], faces: NDArray[np.int32], device: Device, workers: int, sizes: Sizes
    ) -> None:
        if points.dtype not in (np.float32, np.float64):
            points = points.astype(np.float64)
        self.points, self.faces = np.ascontiguousarray(points), faces
        self.device, self.workers, self.sizes = device, workers, sizes
        # With twice as many chunks of faces as workers, a delayed worker does not delay the audit.
        self.chunks = 2 * workers
        self.chunk = -(-len(faces) // self.chunks)
        self.tally = tally_dtype(sizes.valences)
        self.timings: dict[str, float] = {}
        self._held: list[Buffer] = []
        self._clock = time.perf_counter()

    def findings(self) -> Findings:
        """Run all stages and return the findings."""
        self.program = self._build_program()
        self.on_device = self._share(self.faces.view(np.uint32), "faces")
        self._record_stage("open")
        self._count_corners()
        self._record_stage("blocks")
        self._visit_vertices()
        self._record_stage("vertices")
        components, two_face_components = self._count_components()
        self._record_stage("components")
        area, largest_area, largest, loops, strange = self._measure_faces()
        self._record_stage("faces")
        totals = Totals(
            vertex_count=len(self.points),
            faces=self.faces,
            improper=self.improper,
            strange=strange,
            tallies=self.tallies.read().view(self.tally),
            block_edges=self.block_edges.read(),
            valences=self.valences.read()[: int(self.used[0].read()[0])],
            components=components,
            two_face_components=two_face_components,
            boundary_loops=loops,
            largest=largest,
            area=area,
            largest_area=largest_area,
        )
        return add_up(totals, self.timings, f"OpenCL, {self.device.record}")

    def release(self) -> None:
        """Release all buffers after the device has finished with them."""
        self.device.finish()
        for buffer in self._held:
            buffer.release()

    # ---- stages

    def _count_corners(self) -> None:
        """Choose the blocks of vertices, and count the corners (chunks, blocks) of each chunk in each
        block."""
        face_count, vertex_count, sizes = len(self.faces), len(self.points), self.sizes
        count = min(max(3 * face_count // sizes.block_corners, 1), sizes.most_blocks)
        self.shift = max((vertex_count // count).bit_length() - 1, 0)
        self.blocks = -(-vertex_count >> self.shift)
        counts = self._allocate((self.chunks, self.blocks), np.uint32, "corner counts")
        improper = self._allocate((self.chunks, 1 + SAMPLES), np.uint32, "improper faces")
        self.parents = self._allocate_large(face_count, np.uint32, "components")
        scalars = _to_uints(face_count, self.chunk, self.blocks, self.shift)
        self.program.count_corners(self.chunks, 1, self.on_device, counts, self.parents, improper, *scalars)
        self.counts, self.improper = counts.read(), improper.read()
        self.starts = np.concatenate([[0], np.cumsum(self.counts.sum(axis=0, dtype=np.int64))])

    def _visit_vertices(self) -> None:
        """Round by round, move the corners into their blocks and visit the vertices of the blocks."""
        block_sizes, face_count = np.diff(self.starts), len(self.faces)
        share = 3 * face_count // (16 * self.workers)
        self.large = max(self.sizes.large_block, share)
        largest = int(block_sizes.max(initial=0))
        rounds = self.sizes.rounds + (largest > self.large)
        # `room` is the number of corners per round. `room` is 1/32 larger than an equal share, because blocks
        # cannot be divided evenly. `room` is at least the number of corners of the largest block.
        room = max(int(self.starts[-1]) // rounds * 33 // 32, largest)
        self.memory = _allocate_pages(max(room + 1, -(-3 * face_count // 2)) * 16)
        records = self._share(self.memory, "corners")
        words = (self.workers + 1) * self.tally.itemsize // 8
        self.tallies = self._allocate_zeros(words, np.uint64, "tallies")
        self.block_edges = self._allocate_zeros(self.blocks, np.uint64, "block edges")
        self.valences = self._allocate(6 * face_count // self.sizes.valences + 1, np.uint32, "valences")
        self.used = (
            self._allocate_zeros(1, np.uint32, "valences used"),
            self._allocate_zeros(1, np.uint32, "chunks used"),
        )
        self._make_lists(rounds)
        small = self._allocate_scratch(self.workers, self.large)
        large = (
            self._allocate_scratch(1, min(largest, face_count), large=True) if largest > self.large else None
        )
        for first, end in self._plan_rounds(room):
            self._place_corners(records, first, end, room)
            self._visit_blocks(records, first, end, small, large=False)
            if large and block_sizes[first:end].max() > self.large:
                self._visit_blocks(records, first, end, large, large=True)
        self.device.finish()
        for buffer in (records, small[0], *(large or ())[:1]):
            buffer.release()

    def _plan_rounds(self, room: int) -> Iterator[tuple[int, int]]:
        """Yield the first block and the end block of each round.

        A round processes as many blocks as fit into `room` corners.
        """
        first = 0
        while first < self.blocks:
            end = int(np.searchsorted(self.starts, self.starts[first] + room, side="right")) - 1
            yield first, max(end, first + 1)
            first = end

    def _place_corners(self, records: Buffer, first: int, end: int, spare: int) -> None:
        """Run the kernel place_corners for the blocks `first` to `end`.

        `cursors` (chunks, blocks + 1) holds the first position at which each chunk writes into each block.
        Inside a block, the corners of one chunk follow the corners of the previous chunk. The last column is
        a spare position, at which the corners of all other blocks are written.
        """
        counts = self.counts[:, first:end]
        cursors = np.full((self.chunks, end - first + 1), spare, np.uint32)
        cursors[:, :-1] = self.starts[first:end] - self.starts[first] + np.cumsum(counts, axis=0) - counts
        buffer = self._share(cursors, "cursors")
        scalars = _to_uints(len(self.faces), self.chunk, first, end - first, self.shift)
        self.program.place_corners(self.chunks, 1, self.on_device, records, buffer, *scalars)

    def _visit_blocks(
        self, records: Buffer, first: int, end: int, scratch: tuple[Buffer, int], *, large: bool
    ) -> None:
        starts = (self.starts[first : end + 1] - self.starts[first]).astype(np.uint32)
        following = self._allocate_zeros(1, np.uint32, "next block")
        valences_used, chunks_used = self.used
        self.program.visit_blocks(
            1 if large else self.workers, 1,
            records, self._share(starts, "block starts"), self.block_edges, following, self.tallies,
            self.valences, valences_used, self.pairs, self.fills, chunks_used,
            scratch[0], np.uint64(scratch[1]),
            *_to_uints(self.large, large, first, end - first, self.shift, len(self.points)),
        )  # fmt: skip

    def _make_lists(self, rounds: int) -> None:
        """Allocate memory chunks for at most one face pair per half-edge."""
        sizes, kinds = self.sizes, 3
        full = 3 * len(self.faces) // (sizes.chunk_pairs - 2 * sizes.most_compared) + 1
        begun = kinds * (self.workers + 1) * (2 * rounds + 2)
        self.pairs = self._allocate_large((full + begun + 1) * sizes.chunk_pairs, np.uint64, "pairs")
        self.fills = self._allocate(full + begun + 1, np.uint32, "chunks of pairs")

    def _allocate_scratch(self, workers: int, corners: int, *, large: bool = False) -> tuple[Buffer, int]:
        """Return the scratch buffer of the kernel visit_blocks. Also return the number of words for each
        work-item."""
        starts = (1 << self.shift) + 1  # Two 32-bit tables fit into this number of words.
        words = starts + 1 + (4 if large else 6) * corners
        words += words % 2
        return self._allocate_large(words * workers, np.uint64, "scratch"), words

    def _count_components(self) -> tuple[int, int]:
        """Return the number of components across all shared edges and across two-face edges only."""
        self.chunks_used = int(self.used[1].read()[0])
        # Each union of two sets reduces the number of components by one.
        proper = len(self.faces) - int(self.improper[:, 0].sum())
        two_face = proper - self._unite_pairs(TWO_FACE, self.parents)
        return two_face - self._unite_pairs(CROWDED, self.parents), two_face

    def _unite_pairs(self, kind: int, parents: Buffer) -> int:
        """Unite the face pairs of the given kind. Return the number of unions of two different sets."""
        joined = self._allocate_zeros(self.workers, np.uint32, "joined")
        chunk = self._allocate_zeros(1, np.uint32, "next chunk")
        scalars = _to_uints(self.chunks_used, kind)
        self.program.unite_pairs(self.workers, 1, self.pairs, self.fills, parents, chunk, joined, *scalars)
        return int(joined.read().sum(dtype=np.int64))

    def _measure_faces(self) -> tuple[float, float, int, int, NDArray[np.uint32]]:
        """Return the total area, the area and the number of faces of the largest component, the number of
        boundary loops, and the degenerate faces."""
        count = len(self.faces)
        # The next stage needs 24 bytes of memory per face. Reuse the memory of the corners, because the
        # system has already mapped the pages of this memory.
        cuts = np.split(self.memory[: 24 * count], [8 * count, 16 * count, 20 * count])
        areas = self._share(cuts[0].view(np.float64), "areas")
        sums = self._share(cuts[1].view(np.float64), "sums of areas")
        sizes = self._share(cuts[2].view(np.uint32), "component sizes")
        rims = self._share(cuts[3].view(np.uint32), "rims")
        sizes.fill(0)
        strange = self._allocate((self.chunks, 2, 1 + SAMPLES), np.uint32, "strange areas")
        self.program.measure_faces(
            self.chunks, 1, self._share(self.points, "points"), self.on_device,
            areas, self.parents, sizes, rims, strange, *_to_uints(count, self.chunk),
        )  # fmt: skip

        # Unite faces that follow each other along the boundary. In each boundary loop, the last pair connects
        # two faces that are already in one set.
        joined = self._unite_pairs(RIM, rims)
        counts = self._allocate(2, np.uint32, "largest component")
        area_sums = self._allocate(2, np.float64, "areas of the largest component and of all faces")
        self.program.sum_largest(1, 1, areas, self.parents, sizes, sums, counts, area_sums, *_to_uints(count))
        chunk_fills = self.fills.read()[1 : self.chunks_used + 1]
        pairs = int((chunk_fills[chunk_fills % 4 == RIM] // 4).sum(dtype=np.int64))
        largest, single_faces = (int(n) for n in counts.read())
        # Each face without shared edges is an additional boundary loop.
        largest_area, total = (float(x) for x in area_sums.read())
        return total, largest_area, largest, pairs - joined + single_faces, strange.read()

    # ---- buffers

    def _build_program(self) -> Program:
        sizes = self.sizes
        coordinate = "float" if self.points.dtype == np.float32 else "double"
        return self.device.program(
            "audit",
            {
                "COORDINATE": coordinate,
                "SAMPLES": SAMPLES,
                "MOST": sizes.most_compared,
                "PAIRS": sizes.chunk_pairs,
                "VALENCES": sizes.valences,
            },
        )

    def _allocate(self, shape: int | tuple[int, ...], dtype: DTypeLike, use: str) -> Buffer:
        return self._hold(self.device.allocate(shape, dtype, f"audit: {use}"))

    def _allocate_zeros(self, count: int, dtype: DTypeLike, use: str) -> Buffer:
        buffer = self._allocate(count, dtype, use)
        buffer.fill(0)
        return buffer

    def _share(self, array: NDArray[Any], use: str) -> Buffer:
        return self._hold(self.device.share(array, f"audit: {use}"))

    def _allocate_large(self, count: int, dtype: DTypeLike, use: str) -> Buffer:
        return self._share(_allocate_pages(count * np.dtype(dtype).itemsize).view(dtype), use)

    def _hold(self, buffer: Buffer) -> Buffer:
        self._held.append(buffer)
        return buffer

    def _record_stage(self, stage: str) -> None:
        self.device.finish()
        now = time.perf_counter()
        self.timings[stage] = (now - self._clock) * 1e3
        self._clock = now


def _to_uints(*values: int) -> list[np.uint32]:
    return [np.uint32(value) for value in values]


def _allocate_pages(nbytes: int) -> NDArray[np.uint8]:
    """Return uninitialised memory aligned to a page. Large NumPy arrays use huge pages where available."""
    page = 4096
    memory = np.empty(nbytes + page, np.uint8)  # noqa: TID251 - kernels write the memory before reading it
    start = -memory.ctypes.data % page
    return memory[start : start + nbytes]
