"""A fake of the NVIDIA driver library."""

import os
from types import SimpleNamespace
from typing import Any

ME = os.getpid()


def nvml(held: dict[int, int | None], used: int, gpus: int = 1) -> Any:
    """Return a driver whose GPUs list the bytes of each process (`held`) and have `used` bytes in use."""
    driver = SimpleNamespace(NVMLError=RuntimeError, held=held, used=used)
    driver.nvmlInit = lambda: None
    driver.nvmlDeviceGetCount = lambda: gpus
    driver.nvmlDeviceGetHandleByIndex = lambda index: index
    driver.nvmlDeviceGetName = lambda _: "A GPU"
    driver.nvmlDeviceGetUUID = lambda _: b"GPU-1"
    driver.nvmlDeviceGetMemoryInfo = lambda _: SimpleNamespace(used=driver.used, total=1000)
    driver.nvmlDeviceGetGraphicsRunningProcesses = lambda _: []
    driver.nvmlDeviceGetComputeRunningProcesses = lambda _: [
        SimpleNamespace(pid=pid, usedGpuMemory=size) for pid, size in driver.held.items()
    ]
    return driver
