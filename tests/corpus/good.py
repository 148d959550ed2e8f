"""Small good assets, and their parts for making bad assets."""

import copy
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from msb.asset import Asset, Description, build_asset
from msb.asset.build import as_bytes
from msb.asset.manifest import Source, SourceFile, StoredSetting
from msb.asset.texture import Sampler
from tests.corpus.forge import Entry, forge

SHA_OF_NOTHING = hashlib.sha256().hexdigest()
REMOVE = object()
"""The value for `Parts.change` that removes a key."""


def mesh() -> Asset:
    """Return a tetrahedron with uint8 vertex colours: V = 4, F = 4."""
    return build_asset(
        {
            "positions": np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32),
            "indices": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint32),
            "color": np.arange(12, dtype=np.uint8).reshape(4, 3),
        },
        {"color": "vertex"},
    )


def soup() -> Asset:
    """Return two splats of degree 1 with logits and log-sigmas per face: V = 6, F = 2."""
    rng = np.random.default_rng(1)
    return build_asset(
        {
            "positions": rng.normal(size=(6, 3)).astype(np.float32),
            "indices": np.arange(6, dtype=np.uint32).reshape(2, 3),
            "f_dc": rng.normal(size=(2, 3)).astype(np.float32),
            "f_rest": rng.normal(size=(2, 9)).astype(np.float32),
            "opacity": np.array([2.0, -np.inf], np.float32),
            "sigma": np.array([-3.0, 0.5], np.float32),
        },
        dict.fromkeys(("f_dc", "f_rest", "opacity", "sigma"), "face"),
        Description(
            method="triangle_splatting",
            sh_degree=1,
            coverage={"kernel": "incentre_window"},
            opacity={"encoding": "logit"},
            appearance={"kind": "spherical_harmonics", "f_rest_order": "coefficient_major"},
            compositing={"kind": "front_to_back"},
            settings={
                "sh_degree": StoredSetting(1, "checkpoint"),
                "view_dir": StoredSetting("centroid", "flag"),
            },
            source=Source((SourceFile("point_cloud_state_dict.pt", SHA_OF_NOTHING, 0),)),
        ),
    )


def textured() -> Asset:
    """Return a square of two faces with one texture per face: V = 4, F = 2."""
    texels = np.arange(24, dtype=np.uint8).reshape(2, 2, 2, 3) * 10
    buffers = {
        "positions": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32),
        "indices": np.array([[0, 1, 2], [2, 1, 3]], np.uint32),
        "uv": np.array([[0, 1], [1, 1], [0, 0], [0, 0], [1, 1], [1, 0]], np.float32),
        "texture.0": texels[0],
        "texture.1": texels[1],
        "face_texture": np.array([0, 1], np.uint32),
    }
    domains: dict[str, Any] = {"uv": "corner", "face_texture": "face"}
    domains |= {"texture.0": "global", "texture.1": "global"}
    return build_asset(buffers, domains, Description(appearance=Sampler().appearance))


def decoder() -> Asset:
    """Return two faces with lattice features and a global decoder: V = 4, F = 2."""
    rng = np.random.default_rng(2)
    return build_asset(
        {
            "positions": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32),
            "indices": np.array([[0, 1, 2], [2, 1, 3]], np.uint32),
            "features.alpha": rng.integers(0, 256, (2, 3, 1), dtype=np.uint8),
            "features.color": rng.normal(size=(2, 3, 7)).astype(np.float32),
            "decoder.w0": rng.normal(size=(3, 4)).astype(np.float32),
            "decoder.b0": rng.normal(size=3).astype(np.float32),
        },
        {
            "features.alpha": "face",
            "features.color": "face",
            "decoder.w0": "global",
            "decoder.b0": "global",
        },
        Description(
            method="diffsoup",
            opacity={"encoding": "feature"},
            appearance={"kind": "neural_decoder", "lattice_level": 1},
            compositing={"kind": "binary_z_buffer"},
            settings={"z_near": StoredSetting(0.25, "config"), "layout": StoredSetting("colmap", "default")},
        ),
    )


@dataclass
class Parts:
    """The manifest and files of an asset. They can be changed independently."""

    manifest: dict[str, Any]
    files: dict[str, bytes]

    def text(self) -> bytes:
        """Return the manifest as JSON text, like the writer of assets."""
        return (json.dumps(self.manifest, indent=2) + "\n").encode()

    def change(self, pointer: str, value: Any) -> Self:
        """Set the value at a JSON pointer, or remove it if the value is `REMOVE`. Return self."""
        *path, last = pointer[1:].split("/")
        target = self.manifest
        for key in path:
            target = target[int(key) if isinstance(target, list) else key]
        if value is REMOVE:
            del target[last]
        else:
            target[int(last) if isinstance(target, list) else last] = value
        return self

    def set_array(self, name: str, array: np.ndarray) -> Self:
        """Replace the values, shape and hash of a buffer, and return self."""
        spec, data = self.manifest["buffers"][name], array.tobytes()
        spec.update(byte_length=len(data), shape=list(array.shape), sha256=hashlib.sha256(data).hexdigest())
        self.files[spec["file"]] = data
        return self

    def entries(self, manifest: bytes | None = None) -> list[Entry]:
        """Return the members of the packed form, the manifest first."""
        text = self.text() if manifest is None else manifest
        return [Entry("manifest.json", text), *(Entry(name, data) for name, data in self.files.items())]

    def write_packed(self, path: Path, manifest: bytes | None = None) -> None:
        """Write a single file, optionally with another manifest."""
        path.write_bytes(forge(self.entries(manifest)))

    def write_folder(self, path: Path, manifest: bytes | None = None) -> None:
        """Write a folder, optionally with another manifest."""
        (path / "buffers").mkdir(parents=True)
        (path / "manifest.json").write_bytes(self.text() if manifest is None else manifest)
        for name, data in self.files.items():
            (path / name).write_bytes(data)


def parts(asset: Asset) -> Parts:
    """Return the manifest and the files of an asset, in memory."""
    files = {spec.file: bytes(as_bytes(asset.buffers[name])) for name, spec in asset.manifest.buffers.items()}
    return Parts(copy.deepcopy(asset.manifest.to_dict()), files)
