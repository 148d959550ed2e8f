"""Files of LPIPS: VGG16 weights from the user, and the linear layers of the lpips package."""

import hashlib
import importlib.util
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.extras import need_extra
from msb.base.files import file_sha256, library_reason, regular_file
from msb.errors import MetricError

_NUMBERS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
_CHANNELS = (3, *2 * (64,), *2 * (128,), *3 * (256,), *6 * (512,))
# Shape (N, in, out) of each 3 x 3 convolution: number and channels of features.N in torchvision's VGG16.
LAYERS = tuple(zip(_NUMBERS, _CHANNELS[:-1], _CHANNELS[1:], strict=True))
# The number of channels of each compared layer: relu1_2, 2_2, 3_3, 4_3 and 5_3, all after their ReLU.
TAPS = {2: 64, 7: 128, 14: 256, 21: 512, 28: 512}
VGG_FILE = "vgg16-397923af.pth"
# SHA-256 of the published weight file of torchvision. The file name contains the first eight digits.
VGG_SHA256 = "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0"
# SHA-256 of weights/v0.1/vgg.pth in lpips 0.1.4.
HEADS_SHA256 = "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868"
# Sum of the weights of each layer in LPIPS 0.1. The faulty version 0.0 has other sums: 3.64, 1.96, ...
_HEAD_SUMS = (6.9260, 8.8583, 17.5150, 51.5213, 47.0349)
# Upper bound of LPIPS: features are non-negative vectors of length 1, so each component differs by at most 1.
MOST_LPIPS = math.fsum(_HEAD_SUMS) + 0.01
# Maximum header size of a .npy file in bytes.
_MAX_HEAD = 1 << 10

# float32 arrays. The keys are features.N.weight and features.N.bias.
Weights = dict[str, Any]


def find_vgg() -> Path | None:
    """Return torchvision's weight file in the cache of torch, if it exists and LPIPS can be computed.

    The folder is that of `torch.hub.get_dir`: TORCH_HOME, otherwise torch in XDG_CACHE_HOME or ~/.cache.
    """
    if importlib.util.find_spec("torch") is None or importlib.util.find_spec("lpips") is None:
        return None
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    home = Path(os.environ.get("TORCH_HOME") or cache / "torch")
    place = (home / "hub" / "checkpoints" / VGG_FILE).expanduser()
    return place if place.is_file() else None


def weights_source(weights: Mapping[str, Any] | None) -> str:
    """Describe the origin of `LpipsVgg.weights`, and state whether they are the published weights.

    If the weights are missing, the text names the required file.
    """
    if weights is None:
        return f"LPIPS needs {VGG_FILE} from download.pytorch.org/models, SHA-256 {VGG_SHA256[:16]}..."
    vgg, heads = weights["vgg"], weights["heads"]
    source = f"VGG16 is {vgg['file']}, SHA-256 {vgg['sha256'][:16]}..."
    if vgg["known"] is None:
        return f"{source}, which is not torchvision's {VGG_FILE}: not comparable with published LPIPS"
    if heads["known"] is None:
        return f"{source}, from torchvision; the linear layers are not from lpips 0.1.4"
    return f"{source}, from torchvision; the linear layers are from {heads['known']}"


def is_weights_record(data: Any) -> bool:
    """Return whether JSON data has the fields of `LpipsVgg.weights` that `weights_source` reads."""
    vgg, heads = (data.get(name) if isinstance(data, dict) else None for name in ("vgg", "heads"))
    if not isinstance(vgg, dict) or not isinstance(heads, dict):
        return False
    complete = isinstance(vgg.get("file"), str) and isinstance(vgg.get("sha256"), str)
    return complete and all(isinstance(record.get("known", 0), str | None) for record in (vgg, heads))


def check_extra() -> None:
    """Raise UsageError if torch or lpips is not installed."""
    need_extra("lpips", "torch", "lpips", what="LPIPS")


def read_vgg(path: str | os.PathLike[str]) -> tuple[Weights, dict[str, Any]]:
    """Return the convolutions of a VGG16 and a record of their origin.

    The file is a state dict of the torchvision VGG16 written by torch.save, or an .npz with the same keys.
    Other keys of the file (classifier.*) are ignored. Loading does not execute code from the file. Weights
    are features.N.weight (out, in, 3, 3) and features.N.bias (out,), float32. The record has the key "file"
    with the file name, and the key "known" with the name of published weights or None. The key "sha256" is
    the hash of the file. The key "tensors_sha256" is the hash of the values, which does not depend on the
    file format.
    """
    place = regular_file(path)
    shapes: dict[str, tuple[int, ...]] = {f"features.{n}.weight": (o, i, 3, 3) for n, i, o in LAYERS}
    shapes |= {f"features.{n}.bias": (o,) for n, _, o in LAYERS}
    try:
        read = _read_npz if place.suffix.lower() == ".npz" else _read_torch
        tensors = read(place, shapes)
        weights = {key: _check_tensor(place, tensors, key, shape) for key, shape in shapes.items()}
    except MetricError:
        raise
    except Exception as error:  # readers of weights raise various exceptions for files of other formats
        text = f"it cannot be read: {library_reason(error)}"
        raise MetricError("METRIC_WEIGHTS", text, file=place) from error
    digest = hashlib.sha256()
    for key in shapes:
        digest.update(key.encode() + b"\0" + weights[key].astype("<f4").tobytes())
    sha256 = file_sha256(place)
    record = {
        "file": place.name,
        "sha256": sha256,
        "tensors_sha256": digest.hexdigest(),
        "known": f"torchvision {VGG_FILE}" if sha256 == VGG_SHA256 else None,
    }
    return weights, record


def read_heads() -> tuple[list[NDArray[np.float32]], str]:
    """Return the five linear layers (C,) of LPIPS 0.1 for VGG16, and the SHA-256 of their file.

    The lpips package is located without importing it, because the import needs torchvision.
    """
    check_extra()
    import torch

    spec = importlib.util.find_spec("lpips")
    assert spec is not None
    folder = Path(spec.origin or "").parent
    place = folder / "weights" / "v0.1" / "vgg.pth"
    try:
        tensors = torch.load(place, map_location="cpu", weights_only=True)
        heads = [tensors[f"lin{k}.model.1.weight"].numpy() for k in range(5)]
    except Exception as error:
        text = f"the file cannot be read: {library_reason(error)}"
        raise MetricError("METRIC_WEIGHTS", text, file=place) from error
    for head, channels, total in zip(heads, TAPS.values(), _HEAD_SUMS, strict=True):
        if head.shape != (1, channels, 1, 1) or abs(float(head.sum()) - total) > 1e-3:
            text = (
                f"the weights of a layer of shape {head.shape} have the sum {head.sum():.4f}; "
                f"in LPIPS 0.1 the sum is {total}"
            )
            raise MetricError("METRIC_WEIGHTS", text, file=place)
    return [head.reshape(-1).astype(np.float32) for head in heads], file_sha256(place)


def _check_tensor(path: Path, tensors: Weights, key: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
    if key not in tensors:
        text = f"{key} is missing; the file must be a state dict of the torchvision VGG16"
        raise MetricError("METRIC_WEIGHTS", text, file=path, pointer=key)
    array = np.asarray(tensors[key])
    if array.shape != shape or array.dtype.kind != "f":
        text = f"{key} is {array.dtype} of shape {array.shape}; it must be floats of shape {shape}"
        raise MetricError("METRIC_WEIGHTS", text, file=path, pointer=key)
    if not np.isfinite(array).all():
        text = f"{key} contains NaN or infinity"
        raise MetricError("METRIC_WEIGHTS", text, file=path, pointer=key)
    return np.ascontiguousarray(array, np.float32)


def _read_torch(path: Path, shapes: dict[str, tuple[int, ...]]) -> Weights:
    import torch

    tensors = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(tensors, dict):
        text = f"the file holds a {type(tensors).__name__}; it must be a state dict of the torchvision VGG16"
        raise MetricError("METRIC_WEIGHTS", text, file=path)
    return {key: tensors[key].detach().float().numpy() for key in shapes if torch.is_tensor(tensors.get(key))}


def _read_npz(path: Path, shapes: dict[str, tuple[int, ...]]) -> Weights:
    # Open the file in this function, because NumPy leaves an invalid archive open.
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        for key, shape in shapes.items():
            # Check sizes before unpacking. Stored numbers have at most 8 bytes.
            most = 8 * math.prod(shape) + _MAX_HEAD
            if key in archive and archive.zip.getinfo(f"{key}.npy").file_size > most:
                text = f"{key} is too long; it must be floats of shape {shape}"
                raise MetricError("METRIC_WEIGHTS", text, file=path, pointer=key)
        return {key: archive[key] for key in shapes if key in archive}
