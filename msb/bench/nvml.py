"""Memory of processes on NVIDIA GPUs, measured by NVML."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from msb.base.extras import install
from msb.bench.validation import Count, Record


class Gpu(Record):
    """A GPU of this machine, and the peak memory that the command used on this GPU."""

    index: Count
    name: str
    uuid: str
    total_bytes: Count
    peak_bytes: Count | None


class Gpus:
    """The NVIDIA GPUs of this machine.

    If no GPU can be measured, a reason is given: no library, driver or GPU.

    Two numbers are measured: the memory listed by NVML for given processes, and the growth of the whole
    device's memory. If NVML cannot list processes, the growth of device memory is used.
    """

    def __init__(self) -> None:
        # The reason that no GPU can be measured; None if at least one GPU can be measured.
        self._reason: str | None = None
        self._handles: list[Any] = []
        # For each GPU index, the peak memory of the processes in bytes, and the peak growth of the device
        # memory in bytes.
        self._process_peaks: dict[int, int] = {}
        self._device_peaks: dict[int, int] = {}
        # Peak memory, summed over all GPUs.
        self._process_peak = self._device_peak = 0
        # Whether NVML and this system use the same process numbers. In a container, NVML may use other
        # process numbers.
        self._lists_processes = False
        # The latest error reported by NVML.
        self._error: str | None = None
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
        except Exception as error:  # the error class of NVML exists only after NVML is loaded
            self._reason = f"NVML: {error}"
        if not self._handles and self._reason is None:
            self._reason = "this machine has no NVIDIA GPU"

    def look(self, pids: set[int]) -> None:
        """Update the peaks with the current memory of the processes `pids` and the devices."""
        process_sum = device_sum = 0
        for index, handle in enumerate(self._handles):
            # NVML may reject a query of processes but still report the memory of the device.
            with self._record_errors():
                size = self._measure_processes(handle, pids)
                self._process_peaks[index] = max(self._process_peaks.get(index, 0), size)
                process_sum += size
            with self._record_errors():
                growth = max(0, self._nvml.nvmlDeviceGetMemoryInfo(handle).used - self._before[index])
                self._device_peaks[index] = max(self._device_peaks.get(index, 0), growth)
                device_sum += growth
        self._process_peak = max(self._process_peak, process_sum)
        self._device_peak = max(self._device_peak, device_sum)

    @contextlib.contextmanager
    def _record_errors(self) -> Iterator[None]:
        try:
            yield
        except self._nvml.NVMLError as error:
            self._error = f"NVML: {error}"

    def result(self) -> tuple[int | None, Literal["processes", "device"] | None, str | None]:
        """Return the peak memory of all GPUs in bytes and its source.

        If the peak is unknown, return the reason.
        """
        if self._reason is not None:
            return None, None, self._reason
        # If a GPU cannot be measured, the sum over all GPUs is unknown.
        has_processes = len(self._process_peaks) == len(self._handles)
        has_devices = len(self._device_peaks) == len(self._handles)
        if has_processes and (self._lists_processes or (has_devices and not self._device_peak)):
            return self._process_peak, "processes", None
        return (self._device_peak, "device", None) if has_devices else (None, None, self._error)

    def devices(self) -> tuple[Gpu, ...]:
        """Return the peak memory of each GPU."""
        gpus = []
        peaks = self._process_peaks if self.result()[1] == "processes" else self._device_peaks
        for index, handle in enumerate(self._handles):
            with contextlib.suppress(Exception):
                gpus.append(
                    Gpu(
                        index=index,
                        name=_decode(self._nvml.nvmlDeviceGetName(handle)),
                        uuid=_decode(self._nvml.nvmlDeviceGetUUID(handle)),
                        total_bytes=self._nvml.nvmlDeviceGetMemoryInfo(handle).total,
                        peak_bytes=peaks.get(index),
                    )
                )
        return tuple(gpus)

    def measure_process(self, pid: int) -> tuple[int | None, str | None]:
        """Return the current bytes of the process `pid` on all GPUs.

        If the bytes are unknown, return the reason.
        """
        sizes: list[int] = []
        for handle in self._handles if self._reason is None else ():
            with contextlib.suppress(self._nvml.NVMLError):
                listed = self._list_processes(handle)
                sizes += [listed[pid]] if pid in listed else []
        # Do not use the memory of the whole device, because other processes also use device memory.
        unlisted = "NVML lists no memory of this process: it uses no NVIDIA GPU, or it runs in a container"
        return (sum(sizes), None) if sizes else (None, self._reason or unlisted)

    def _list_processes(self, handle: Any) -> dict[int, int]:
        """Return the bytes of each process on a GPU, by process number. Unknown values are omitted."""
        sizes: dict[int, int] = {}
        for processes in (
            self._nvml.nvmlDeviceGetComputeRunningProcesses(handle),
            self._nvml.nvmlDeviceGetGraphicsRunningProcesses(handle),
        ):
            for process in processes:
                if process.usedGpuMemory is not None:
                    sizes[process.pid] = max(sizes.get(process.pid, 0), process.usedGpuMemory)
        return sizes

    def _measure_processes(self, handle: Any, pids: set[int]) -> int:
        """Return the bytes of the processes `pids` on a GPU."""
        import psutil

        sizes = self._list_processes(handle)
        # In a container, NVML lists no processes, or lists them with the process numbers of the host.
        known = any(pid in pids or psutil.pid_exists(pid) for pid in sizes)
        self._lists_processes = self._lists_processes or known
        return sum(size for pid, size in sizes.items() if pid in pids)


def read_driver_memory(device: Mapping[str, Any]) -> tuple[int | None, str | None]:
    """Return the bytes of this process on NVIDIA GPUs. If the bytes are unknown, return the reason.

    `device` is the key "device" of the record of a machine.
    """
    if device.get("kind") != "gpu":
        return None, "the rendering device is not a GPU"
    return Gpus().measure_process(os.getpid())


def _decode(value: str | bytes) -> str:
    return value.decode() if isinstance(value, bytes) else value
