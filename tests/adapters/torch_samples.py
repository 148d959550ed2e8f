"""Sample values for torch.save. `python -m tests.adapters.torch_samples` writes tests/golden/checkpoints.

Run it manually if torch is installed. The stored files are from torch 2.13, and the tests read them without
torch.
"""

import json
import warnings
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch

from msb.adapters.checkpoint import BFloat16Array
from tests.adapters.describe import describe

GOLDEN = Path(__file__).parent.parent / "golden" / "checkpoints"
DTYPES = [torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.int8, torch.int16]
DTYPES += [torch.int32, torch.int64, torch.uint8, torch.bool]


def numbers(*shape: int, dtype: Any = torch.float32) -> Any:
    count = int(np.prod(shape))
    return ((torch.arange(count) * 7 + 3) % 11).reshape(shape).to(dtype)


def dtypes() -> Any:
    return {str(dtype): numbers(2, 3, dtype=dtype) for dtype in DTYPES}


def special_values() -> Any:
    values = torch.tensor([0.0, -0.0, float("inf"), -float("inf"), float("nan"), 1e-7, 65504.0])
    return [values.to(dtype) for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16)]


def windows() -> Any:
    base = numbers(6, 8)
    return {
        "base": base,
        "transposed": base.t(),
        "inner": base[1:4, 2:7],
        "stepped": base[::2, 1::3],
        "row": base[3],
        "column": base[:, 5],
        "element": base[4, 4],
        "prefix": base.reshape(-1)[:40],
        "permuted": base.reshape(2, 3, 8).permute(2, 0, 1),
        "unsqueezed": base[2:3, None, 1:2],
        "diagonal": base.diagonal(),
        "half": numbers(5, 5, dtype=torch.bfloat16)[1:, ::2],
        "overlapping": torch.as_strided(base, (3, 4), (2, 1), 1),
    }


def empties() -> Any:
    return {
        "plain": torch.zeros(0),
        "middle": torch.zeros(3, 0, 2),
        "slice": numbers(4, 4)[2:2],
        "integers": torch.zeros(0, 3, dtype=torch.int32),
        "bfloat16": torch.zeros(0, dtype=torch.bfloat16),
    }


def scalars() -> Any:
    return {str(dtype): numbers(1, dtype=dtype).reshape(()) for dtype in DTYPES}


def shared() -> Any:
    base = numbers(12)
    return [base, base, base[3:9], base.reshape(3, 4), {"again": base}]


def parameters() -> Any:
    torch.manual_seed(0)
    layers = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.BatchNorm1d(2))
    return {
        "parameter": torch.nn.Parameter(numbers(2, 3)),
        "frozen": torch.nn.Parameter(numbers(2), requires_grad=False),
        "leaf": numbers(2).requires_grad_(),
        "state": layers.state_dict(),
    }


def optimizer() -> Any:
    torch.manual_seed(0)
    weights = [torch.nn.Parameter(numbers(3, 2)), torch.nn.Parameter(numbers(4))]
    adam = torch.optim.Adam([{"params": weights[:1], "lr": 0.1, "name": "w"}, {"params": weights[1:]}])
    sum((weight**2).sum() for weight in weights).backward()
    adam.step()
    return (OrderedDict(w=weights[0].detach()), adam.state_dict(), None, 1.5)


def plain_values() -> Any:
    return {
        "integers": [0, 1, -1, 255, 256, 65535, 65536, -(1 << 31), 1 << 31, 1 << 40, 1 << 70, -(1 << 63)],
        "floats": [0.0, -0.0, 1.5, float("inf"), float("nan"), 5e-324],
        "text": ["", "a", "Größe €😀", "x" * 300],
        "flags": (True, False, None),
        "tuples": ((), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)),
        "empty": [{}, [], (), OrderedDict()],
        7: "key",
        -3: {"deep": [{"er": ({"still": [1]},)}]},
        "bytes": b"\x00\xff",
        "losses": [i / 7 for i in range(400)],
        "many": [[f"key {i}", f"key {i}"] for i in range(200)],
    }


def numpy_scalars() -> Any:
    types = "float64 float32 float16 int64 int32 int16 int8 uint64 uint32 uint16 uint8 bool"
    return {name: np.dtype(name).type(1) for name in types.split()} | {"pi": np.float64(np.pi)}


SAMPLES: dict[str, Callable[[], Any]] = {
    make.__name__: make
    for make in (
        *(dtypes, special_values, windows, empties, scalars, shared, parameters, optimizer, plain_values),
        numpy_scalars,
    )
}
VARIANTS = {
    f"{layout}{protocol}": (layout == "zip", protocol)
    for layout in ("zip", "legacy")
    for protocol in (2, 3, 4)
}


def save(value: Any, path: Path, variant: str, location: str = "cpu") -> None:
    """Save `value` in a variant of the format; `location` is the device that the storages state."""
    new, protocol = VARIANTS[variant]
    with warnings.catch_warnings(), mock.patch("torch.serialization.location_tag", return_value=location):
        warnings.simplefilter("ignore")
        torch.save(value, path, pickle_protocol=protocol, _use_new_zipfile_serialization=new)


def plain(value: Any) -> Any:
    """Convert a value that torch loaded to the result expected from `read_checkpoint`."""
    if isinstance(value, torch.Tensor):
        value = value.detach()
        if value.dtype == torch.bfloat16:
            return BFloat16Array(value.view(torch.int16).numpy().view(np.uint16))
        return value.numpy()
    if isinstance(value, dict):
        return {plain(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(plain(item) for item in value)
    return value.item() if isinstance(value, np.generic) else value


def write_golden() -> None:
    """Write the files, and their content as torch reads it."""
    GOLDEN.mkdir(parents=True, exist_ok=True)
    expected: dict[str, Any] = {}
    kept: dict[str, np.ndarray] = {}
    for name, make in SAMPLES.items():
        for variant in ("zip2", "legacy2", *(("zip3", "zip4", "legacy4") if name == "optimizer" else ())):
            stem = f"{name}_{variant}"
            save(make(), GOLDEN / f"{stem}.pt", variant, "cuda:0" if variant == "zip2" else "cpu")
            loaded = torch.load(GOLDEN / f"{stem}.pt", map_location="cpu", weights_only=False)
            arrays: list[np.ndarray] = []
            described = describe(plain(loaded), arrays)
            assert expected.setdefault(name, described) == described
            # Make arrays contiguous without adding an axis to 0-dimensional ones.
            kept |= {f"{name}/{i}": np.array(array, order="C") for i, array in enumerate(arrays)}
    (GOLDEN / "expected.json").write_text(json.dumps(expected) + "\n", encoding="utf-8")
    np.savez_compressed(GOLDEN / "expected.npz", **kept)


if __name__ == "__main__":
    write_golden()
