"""Capabilities of a device, as reported by its platform."""

import re
from dataclasses import asdict, dataclass
from typing import Any, Literal

Kind = Literal["cpu", "gpu", "accelerator", "other"]
Style = Literal["cpu", "gpu"]
STYLES: tuple[Style, ...] = ("cpu", "gpu")

_SHORT_NAMES = {
    "Portable Computing Language": "pocl",
    "AMD Accelerated Parallel Processing": "amd",
}
# Platforms whose compiler is known to accept kernels of the CPU style. The compilers of Mesa and Oclgrind
# crash at a prefetch builtin.
_CPU_STYLE_PLATFORMS = ("pocl", "intel")
# Maximum vector width of a kernel, in floats. PoCL 3.0 reports width 16 on AVX-512 processors, but crashes
# on such vectors.
_WIDEST_VECTOR = 8


@dataclass(frozen=True)
class DeviceRecord:
    """A device of a platform: names, limits and capabilities.

    Sizes are in bytes, `clock_mhz` in MHz, `timer_resolution_ns` in nanoseconds. The fields repeat
    clGetDeviceInfo and clGetPlatformInfo (OpenCL 1.2 specification, sections 4.1 and 4.2), except for the
    following.

    Attributes
    ----------
    selector : str
        The text that selects this device, such as ``pocl:0``.
    vector_width : int
        The widest float vector that a kernel should use for speed: the reported native width, at most 8.
    alignment : int
        Alignment of the start of a sub-buffer in bytes (CL_DEVICE_MEM_BASE_ADDR_ALIGN counts bits).
    correctly_rounded : bool
        Whether the device can round single-precision division and square root correctly; our kernels then
        request correct rounding.
    int64_atomics : bool
        Whether cl_khr_int64_base_atomics and cl_khr_int64_extended_atomics are both available (atom_max on
        ulong).
    """

    selector: str
    platform: str
    platform_version: str
    platform_index: int
    name: str
    vendor: str
    version: str
    driver: str
    opencl_c: str
    kind: Kind
    compute_units: int
    clock_mhz: int
    global_memory: int
    max_allocation: int
    local_memory: int
    local_memory_dedicated: bool
    max_work_group: int
    vector_width: int
    int64_atomics: bool
    fp64: bool
    correctly_rounded: bool
    alignment: int
    host_unified: bool
    timer_resolution_ns: int

    @property
    def style(self) -> Style:
        """The style of kernels that suits the device. Only this property chooses the kernel style.

        Kernels of style "cpu" have few work-items with long private loops and no local memory. Kernels of
        style "gpu" have work-groups that share local memory. Any OpenCL compiler accepts kernels of the
        style "gpu". The kernel style "cpu" uses extensions of clang, so only tested compilers get it.
        """
        known = self.kind == "cpu" and short_name(self.platform) in _CPU_STYLE_PLATFORMS
        return "cpu" if known else "gpu"

    def to_dict(self) -> dict[str, Any]:
        """Return this device record as plain JSON data."""
        return {**asdict(self), "style": self.style}

    def __str__(self) -> str:
        return f"{self.selector} ({self.name}, driver {self.driver})"


def short_name(platform: str) -> str:
    """Return the short name of a platform for device selectors.

    >>> short_name("Portable Computing Language"), short_name("Intel(R) OpenCL"), short_name("NVIDIA CUDA")
    ('pocl', 'intel', 'nvidia')
    """
    word = re.match(r"[a-z0-9]+", platform.lower())
    return _SHORT_NAMES.get(platform) or (word[0] if word else "platform")


def describe(cl: Any, device: Any, selector: str, platform_index: int) -> DeviceRecord:
    """Return the device record of a pyopencl device."""
    extensions = set(device.extensions.split())
    config = cl.device_fp_config
    return DeviceRecord(
        selector=selector,
        platform=device.platform.name.strip(),
        platform_version=device.platform.version.strip(),
        platform_index=platform_index,
        name=device.name.strip(),
        vendor=device.vendor.strip(),
        version=device.version.strip(),
        driver=device.driver_version.strip(),
        opencl_c=device.opencl_c_version.strip(),
        kind=_kind(cl, device),
        compute_units=device.max_compute_units,
        clock_mhz=device.max_clock_frequency,
        global_memory=device.global_mem_size,
        max_allocation=device.max_mem_alloc_size,
        local_memory=device.local_mem_size,
        local_memory_dedicated=device.local_mem_type == cl.device_local_mem_type.LOCAL,
        max_work_group=device.max_work_group_size,
        vector_width=max(1, min(_WIDEST_VECTOR, device.native_vector_width_float)),
        int64_atomics={"cl_khr_int64_base_atomics", "cl_khr_int64_extended_atomics"} <= extensions,
        fp64=device.double_fp_config != 0,
        correctly_rounded=bool(device.single_fp_config & config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
        alignment=device.mem_base_addr_align // 8,
        host_unified=bool(device.host_unified_memory),
        timer_resolution_ns=device.profiling_timer_resolution,
    )


def _kind(cl: Any, device: Any) -> Kind:
    types = cl.device_type
    kinds: tuple[tuple[int, Kind], ...] = (
        (types.CPU, "cpu"),
        (types.GPU, "gpu"),
        (types.ACCELERATOR, "accelerator"),
    )
    return next((kind for flag, kind in kinds if device.type & flag), "other")
