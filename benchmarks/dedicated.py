"""Time the stages of the dedicated tier's pipeline on synthetic models of realistic size.

    python -m benchmarks.dedicated                           all parts
    python -m benchmarks.dedicated --parts stages --faces 100000 --method two_dts
    python -m benchmarks.dedicated --device gpu              stages only, with frames per second

Parts:

- `stages`: the time of every stage of every method, and the share of a frame before blending. The projection
  is compared with plain C that moves the same bytes. The frame is compared with a textbook pipeline (official
  tile rectangles, no early stop).
- `blend`: the blend stage of 2DTS, compared with a hand-written loop in C and a kernel with work-groups.
- `threads`: one thread compared with all threads.

The models are described in dedicated_scenes.py. Competitors take turns within a round, so that changes of the
machine's speed affect all equally. The tables show medians over rounds, and medians of the ratios within a
round.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.dedicated_scenes import BLENDED, SIZES, camera, model
from benchmarks.measure import c_library, keep, machine

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cl import Device

FACES = (100_000, 300_000, 1_000_000, 3_000_000)
PARTS = ("stages", "blend", "threads")
BEFORE = ("project", "sort", "bin")
STAGES = (*BEFORE, "blend", "resolve")
BLACK = (0.0, 0.0, 0.0)
WARM_UP = 3
"""Warm-up frames. From the third frame on, faces are stored in drawing order."""


class Peer:
    """The functions of dedicated_peer.c.

    Raises
    ------
    RuntimeError
        No C compiler builds it, or the processor lacks AVX2 or FMA.
    """

    def __init__(self) -> None:
        self._library = c_library(Path(__file__).with_name("dedicated_peer.c"), "-mavx2", "-mfma")
        if not self._library.can_run():
            raise RuntimeError("this processor has no AVX2 or no FMA")

    def milliseconds(self, name: str, *arguments: Any) -> float:
        """Call the C function `name`. Arrays are passed by address."""
        values = [
            ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value
            for value in arguments
        ]
        begun = time.perf_counter()
        getattr(self._library, name)(*values)
        return 1e3 * (time.perf_counter() - begun)


def peer(device: Device) -> Peer | None:
    """Return the C peer. Return None on a GPU or without a compiler."""
    if device.record.kind != "cpu":
        return None
    try:
        return Peer()
    except RuntimeError as error:
        print(f"not compared with C: {error}")
        return None


def traffic(peer: Peer, asset: Asset, visible: np.ndarray, written: np.ndarray) -> Callable[[], float]:
    """Return a function that measures the milliseconds that C needs to move the bytes of a projection.

    For a soup, the projection reads the bounding spheres of all faces. It also reads positions, opacities and
    colours of the kept faces, and writes a record per kept face. For a mesh, it reads positions and colours
    of all vertices, and three indices per face.
    """
    buffers = asset.buffers
    kept = np.flatnonzero(visible).astype(np.uint32)
    whole = [np.ones((len(visible), 4), np.float32)]
    if asset.manifest.topology == "triangle_soup":
        rows = [(buffers["positions"].reshape(-1, 9), kept)]
        rows += [(buffers[name], kept) for name in ("opacity", "f_dc", "f_rest")]
    else:
        corners = buffers["indices"][kept].reshape(-1)
        whole += [buffers["f_dc"], buffers["f_rest"]]
        rows = [(buffers["indices"].view(np.float32), kept)]
        rows += [(buffers[name], corners) for name in ("positions", "opacity", "f_dc")]

    def run() -> float:
        took = sum(peer.milliseconds("read_all", array, ctypes.c_long(array.size)) for array in whole)
        for array, numbers in rows:
            width = array.size // len(array)
            took += peer.milliseconds("read_rows", array, numbers, ctypes.c_long(len(numbers)), width)
        return took + peer.milliseconds("write_all", written, ctypes.c_long(written.size))

    return run


def stages(
    method: str,
    faces: int,
    sizes: Sequence[Sequence[int]],
    rounds: int,
    selected: tuple[str | None, Any],
    alone: bool,
) -> list[dict[str, Any]]:
    """Return a row for each image size. If `alone` is true, the competitors are skipped."""
    from msb.cl import open_device
    from msb.render.splat.pipeline import SplattingPipeline

    asset, found = model(method, faces), []
    with open_device(selected[0], style=selected[1]) as device:
        ours = SplattingPipeline(asset, device=device, outputs=())
        plain = SplattingPipeline(asset, device=device, outputs=(), early_stop=False, exact_tiles=False)
        c = None if alone else peer(device)
        for width, height in sizes:
            view = camera(width, height)
            visible = ours.render(view, BLACK).visible
            assert visible is not None
            record = np.zeros((int(visible.sum()), ours.record_words), np.float32)
            moved = traffic(c, asset, visible, record) if c else None
            for pipeline in (ours, *(() if alone else (plain,))):
                for _ in range(WARM_UP):
                    pipeline.draw(view, BLACK)
            drawn, textbook, floor = [], [], []
            for _ in range(rounds):
                drawn.append(ours.draw(view, BLACK))
                if not alone:
                    textbook.append(sum(plain.draw(view, BLACK).stages.values()))
                if moved:
                    floor.append(moved())
            counts = ours.counts
            totals = [sum(one.stages.values()) for one in drawn]
            shares = [
                sum(one.stages[name] for name in BEFORE) / total
                for one, total in zip(drawn, totals, strict=True)
            ]
            row: dict[str, Any] = {
                "method": method,
                "faces": asset.manifest.face_count,
                "size": f"{width}x{height}",
                **counts,
                "ms": {name: median(one.stages[name] for one in drawn) for name in STAGES},
                "sum": median(totals),
                "span": median(one.span for one in drawn),
                "before blending": median(shares),
                "rounds": [dict(one.stages) for one in drawn],
            }
            if textbook:
                row["textbook"] = median(textbook)
                row["textbook / ours"] = _ratio(textbook, totals)
            if floor:
                row["traffic"] = median(floor)
                row["project / traffic"] = _ratio([one.stages["project"] for one in drawn], floor)
            found.append(row)
        ours.close()
        plain.close()
    return found


def _ratio(values: Sequence[float], others: Sequence[float]) -> float:
    return median(value / other for value, other in zip(values, others, strict=True))


def blends(faces: int, sizes: Sequence[Sequence[int]], rounds: int) -> list[dict[str, Any]]:
    """Return a row per image size: the milliseconds of the blend stage of 2DTS and of its competitors."""
    from msb.cl import open_device
    from msb.render.splat.pipeline import SplattingPipeline

    asset, found = model("two_dts", faces), []
    with open_device("cpu") as cpu, open_device("cpu", style="gpu") as gpu, open_device("cpu") as whole:
        by_hand = peer(cpu)
        ours = SplattingPipeline(asset, device=cpu, outputs=())
        ways: dict[str, Any] = {
            "ours": ours,
            "work-groups": SplattingPipeline(asset, device=gpu, outputs=()),
            "no early stop": SplattingPipeline(asset, device=whole, outputs=(), early_stop=False),
        }
        for width, height in sizes:
            view = camera(width, height)
            for pipeline in ways.values():
                for _ in range(WARM_UP):
                    pipeline.draw(view, BLACK)
            image = ours.render(view, BLACK).image
            columns, rows = -(-width // 16), -(-height // 16)
            pairs = ours.counts["pairs"]
            with ours._scope.turn():  # the scratch buffers belong to the active renderer
                starts = cpu.scratch("splat tile starts", columns * rows + 1, np.uint64).read()
                lists = cpu.scratch("splat tile lists", pairs, np.uint32).read()
                records = cpu.scratch("splat faces", (faces, ours.record_words), np.uint32).read()
            assert starts[-1] == pairs, "C would read elsewhere"
            assert lists.max() < faces, "C would read elsewhere"
            # The array is aligned to 32 bytes, because C stores vectors to it.
            memory = np.zeros(5 * rows * columns * 256 + 8, np.float32)
            planes = memory[-memory.ctypes.data % 32 // 4 :][: memory.size - 8]
            took: dict[str, list[float]] = {name: [] for name in (*ways, *(["C"] if by_hand else []))}
            for _ in range(rounds + 1):
                for name, pipeline in ways.items():
                    took[name].append(pipeline.draw(view, BLACK).stages["blend"])
                if by_hand:
                    arrays = starts, lists, records, planes
                    took["C"].append(by_hand.milliseconds("blend", *arrays, width, height, columns, rows))
            if by_hand:  # only equal images can be compared
                same = planes.reshape(5, 16 * rows, 16 * columns)[:3, :height, :width].transpose(1, 2, 0)
                assert np.abs(same - image).max() < 2e-3
            took = {name: values[1:] for name, values in took.items()}
            row: dict[str, Any] = {
                "faces": faces,
                "size": f"{width}x{height}",
                "pairs": pairs,
                "ms": {name: median(values) for name, values in took.items()},
                "to ours": {name: _ratio(values, took["ours"]) for name, values in took.items()},
                "rounds": took,
            }
            if by_hand:
                row["ours / C"] = _ratio(took["ours"], took["C"])
            found.append(row)
        for pipeline in ways.values():
            pipeline.close()
    return found


def print_stages(rows: list[dict[str, Any]], *, head: bool) -> None:
    """Print one line per model and image size."""
    if head:
        print(
            f"\n{'method':18} {'faces':>8} {'size':>8} {'listed':>8} {'pairs':>8}",
            *(f"{name:>7}" for name in (*STAGES, "sum", "before")),
            f"{'/ traffic':>9} {'textbook':>8}",
        )
    for row in rows:
        print(
            f"{row['method']:18} {row['faces']:8} {row['size']:>8} {row['listed']:8} {row['pairs']:8}",
            *(f"{value:7.1f}" for value in (*row["ms"].values(), row["sum"])),
            f"{row['before blending']:7.0%}",
            f"{row['project / traffic']:9.1f}" if "traffic" in row else f"{'-':>9}",
            f"{row['textbook / ours']:8.2f}" if "textbook" in row else f"{'-':>8}",
        )


def print_blends(rows: list[dict[str, Any]], *, head: bool) -> None:
    """Print one line per model and image size."""
    names = list(rows[0]["ms"])
    if head:
        titles = (f"{name:>13}" for name in names)
        print(f"\n{'blend, faces':>12} {'size':>8} {'pairs':>8}", *titles, "ours / C")
    for row in rows:
        ratio = f"{row['ours / C']:8.2f}" if "ours / C" in row else ""
        times = (f"{row['ms'][name]:13.1f}" for name in names)
        print(f"{row['faces']:12} {row['size']:>8} {row['pairs']:8}", *times, ratio)


def print_paper(rows: list[dict[str, Any]]) -> None:
    """Print frames per second.

    The frame rates of the paper's Unity players are shown beside them. These were measured on an RTX 4090 and
    averaged over the scenes.
    """
    from msb.report.paper import paper_row

    titles = f"{'frames/s':>8} {'ms':>7} {'paper: frames/s':>17} {'GPU ms':>8}"
    print(f"\n{'method':18} {'faces':>8} {'size':>8}", titles)
    where = {"scene": "mean", "condition": "dedicated"}
    for row in rows:
        unity = paper_row("mip360_renderer_comparison", method=row["method"], **where).get("fps")
        gpu = paper_row("mip360_unity_gpu_latency", method=row["method"], **where).get("p50_ms")
        print(
            f"{row['method']:18} {row['faces']:8} {row['size']:>8}",
            f"{1e3 / row['span']:8.0f} {row['span']:7.1f}",
            f"{'--' if unity is None else f'{unity:.0f}':>17} {'--' if gpu is None else f'{gpu:.1f}':>8}",
        )


def moderate(faces: Sequence[int]) -> int:
    """Return the largest entry of `faces` up to a million. A comparison of this size takes seconds."""
    return max((count for count in faces if count <= 1_000_000), default=min(faces))


def on_one_thread(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of `stages` from a process with one thread."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name, "one.json")
        command = [sys.executable, "-m", "benchmarks.dedicated", "--parts", "stages", "--alone"]
        command += ["--faces", str(moderate(options.faces))]
        for width, height in options.size:
            command += ["--size", str(width), str(height)]
        command += ["--method", *options.method, "--rounds", str(options.rounds), "--json", str(out)]
        environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": "1"}
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        return list(json.loads(out.read_text())["stages"])


def print_threads(one: list[dict[str, Any]], every: list[dict[str, Any]]) -> None:
    """Print the speed-up of all threads over one."""
    print(f"\n{'one thread / all':18} {'faces':>8} {'size':>8}", *(f"{name:>7}" for name in (*STAGES, "sum")))
    for row in one:
        same = next(other for other in every if all(other[k] == row[k] for k in ("method", "faces", "size")))
        ratios = [row["ms"][name] / same["ms"][name] for name in STAGES]
        print(
            f"{row['method']:18} {row['faces']:8} {row['size']:>8}",
            *(f"{ratio:7.2f}" for ratio in (*ratios, row["sum"] / same["sum"])),
        )


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--faces", type=int, nargs="+", default=FACES)
    parser.add_argument("--method", nargs="+", choices=BLENDED, default=BLENDED)
    parser.add_argument(
        "--size", type=int, nargs=2, action="append", metavar=("WIDTH", "HEIGHT"), help=f"default: {SIZES}"
    )
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--alone", action="store_true", help="our pipeline only, without competitors")
    parser.add_argument("--device", help="as MSB_DEVICE")
    parser.add_argument("--style", choices=("cpu", "gpu"), help="style of the kernels; default: by device")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    options.size = options.size or SIZES

    from msb.cl import open_device

    with open_device(options.device, style=options.style) as device:
        record, style = device.record, device.style
    found: dict[str, Any] = {
        "machine": machine("numpy", "pyopencl", "pocl-binary-distribution"),
        "device": f"{record.name}, {record.platform_version}, driver {record.driver}, kernels for a {style}",
        "rounds": options.rounds,
    }
    print("\n".join(f"{key}: {value}" for key, value in found["machine"].items()))
    print(f"device: {found['device']}\nmedians of {options.rounds} rounds, milliseconds")
    own_cpu = record.kind == "cpu" and style == "cpu"
    if "stages" in options.parts:
        found["stages"] = rows = []
        for method in options.method:
            for faces in options.faces:
                selected = options.device, options.style
                rows += stages(method, faces, options.size, options.rounds, selected, options.alone)
                print_stages(rows[-len(options.size) :], head=len(rows) == len(options.size))
                sys.stdout.flush()
        if not own_cpu:
            print_paper(rows)
    if "blend" in options.parts and own_cpu:
        found["blend"] = rows = []
        for faces in sorted({min(options.faces), moderate(options.faces)}):
            rows += blends(faces, options.size, options.rounds)
            print_blends(rows[-len(options.size) :], head=len(rows) == len(options.size))
            sys.stdout.flush()
    if "threads" in options.parts and own_cpu and "stages" in found:
        found["one thread"] = on_one_thread(options)
        print_threads(found["one thread"], found["stages"])
    keep(found, options.json)


if __name__ == "__main__":
    main()
