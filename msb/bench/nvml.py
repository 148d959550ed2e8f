"""How much memory processes hold on NVIDIA's GPUs."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from msb.base.extras import install
from msb.bench.checked import Count, Record


class Gpu(Record):
    """One GPU of the machine, and the most memory the command held on it, None if nobody knows."""

    index: Count
    name: str
    uuid: str
    total_bytes: Count
    peak_bytes: Count | None


class Gpus:
    """NVIDIA's GPUs through NVML, or the reason why there are none: no library, no driver or no GPU."""

    def __init__(self) -> None:
        self._reason: str | None = None
        self._handles: list[Any] = []
        self._own: dict[int, int] = {}
        self._more: dict[int, int] = {}
        self._peak_own = self._peak_more = 0
        self._tells = False
        self._refused: str | None = None
        self._nvml: Any = None
        try:
            import pynvml

            self._nvml = pynvml
            pynvml.nvmlInit()
            count = pynvml.nvmlDeviceGetCount()
            self._handles = [pynvml.nvmlDeviceGetHandleByIndex(index) for index in range(count)]
            self._before = [pynvml.nvmlDeviceGetMemoryInfo(handle).used for handle in self._handles]
        except ImportError:
            self._reason = f"the extra gpu is not installed: {install('gpu')}"
        except Exception as error:  # NVML's own error class is made when it loads
            self._reason = f"NVML: {error}"
        if not self._handles and self._reason is None:
            self._reason = "there is no NVIDIA GPU"

    def look(self, pids: set[int]) -> None:
        """Update the peaks with the memory that the processes `pids`, and the devices, hold now."""
        own = more = 0
        for index, handle in enumerate(self._handles):
            # Where NVML may not list processes it still tells what the device holds, so each is asked alone.
            with self._noting_refusals():
                held = self._held(handle, pids)
                self._own[index] = max(self._own.get(index, 0), held)
                own += held
            with self._noting_refusals():
                grown = max(0, self._nvml.nvmlDeviceGetMemoryInfo(handle).used - self._before[index])
                self._more[index] = max(self._more.get(index, 0), grown)
                more += grown
        self._peak_own, self._peak_more = max(self._peak_own, own), max(self._peak_more, more)

    @contextlib.contextmanager
    def _noting_refusals(self) -> Iterator[None]:
        try:
            yield
        except self._nvml.NVMLError as error:
            self._refused = f"NVML: {error}"

    def result(self) -> tuple[int | None, Literal["processes", "device"] | None, str | None]:
        """Return the peak of all GPUs in bytes, its source, and the reason if there is no peak."""
        if self._reason is not None:
            return None, None, self._reason
        # A sum is of all GPUs, or it is none.
        own, more = (len(told) == len(self._handles) for told in (self._own, self._more))
        if own and (self._tells or (more and not self._peak_more)):
            return self._peak_own, "processes", None
        return (self._peak_more, "device", None) if more else (None, None, self._refused)

    def devices(self) -> tuple[Gpu, ...]:
        """Return the GPUs and the peak on each."""
        gpus = []
        peaks = self._own if self.result()[1] == "processes" else self._more
        for index, handle in enumerate(self._handles):
            with contextlib.suppress(Exception):
                gpus.append(
                    Gpu(
                        index=index,
                        name=_text(self._nvml.nvmlDeviceGetName(handle)),
                        uuid=_text(self._nvml.nvmlDeviceGetUUID(handle)),
                        total_bytes=self._nvml.nvmlDeviceGetMemoryInfo(handle).total,
                        peak_bytes=peaks.get(index),
                    )
                )
        return tuple(gpus)

    def of_process(self, pid: int) -> tuple[int | None, str | None]:
        """Return the bytes that the process `pid` holds now on all GPUs, or the reason if nobody knows."""
        held: list[int] = []
        for handle in self._handles if self._reason is None else ():
            with contextlib.suppress(self._nvml.NVMLError):
                listed = self._listed(handle)
                held += [listed[pid]] if pid in listed else []
        # It is the buffers' neighbour in a table: what the whole device holds is no figure of this process.
        unlisted = "NVML names no memory of this process: it uses no NVIDIA GPU, or it is in a container"
        return (sum(held), None) if held else (None, self._reason or unlisted)

    def _listed(self, handle: Any) -> dict[int, int]:
        """Return process -> bytes of those whose memory NVML tells."""
        held: dict[int, int] = {}
        for listed in (
            self._nvml.nvmlDeviceGetComputeRunningProcesses(handle),
            self._nvml.nvmlDeviceGetGraphicsRunningProcesses(handle),
        ):
            for process in listed:
                if process.usedGpuMemory is not None:
                    held[process.pid] = max(held.get(process.pid, 0), process.usedGpuMemory)
        return held

    def _held(self, handle: Any, pids: set[int]) -> int:
        import psutil

        held = self._listed(handle)
        # In a container NVML lists none, or the host's numbers: then it can tell no process from another.
        self._tells = self._tells or any(pid in pids or psutil.pid_exists(pid) for pid in held)
        return sum(size for pid, size in held.items() if pid in pids)


def driver_memory(device: Mapping[str, Any]) -> tuple[int | None, str | None]:
    """Return the bytes that this process holds on NVIDIA's GPUs, or why nobody knows.

    `device` is "device" of a machine's record: what draws.
    """
    if device.get("kind") != "gpu":
        return None, "what draws is no GPU"
    return Gpus().of_process(os.getpid())


def _text(value: str | bytes) -> str:
    return value.decode() if isinstance(value, bytes) else value
