"""Small files of Gaussian splats in every format, encoded here independently of the readers."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image

from msb.asset.sh import SH_C0
from msb.splats.gaussians import Gaussians
from tests.meshes.builders import glb_file

COUNT = 300
FLIP = np.array([1.0, -1.0, -1.0])
# Signs of SH coefficients after half a turn about x: basis functions that are odd in y z together.
SH_FLIP = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])


def gaussians(degree: int = 1, axes: int = 3, count: int = COUNT) -> Gaussians:
    """Return random Gaussians, whose values all formats can represent approximately."""
    random = np.random.default_rng(degree + 10 * axes)
    rotation = random.normal(size=(count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    rotation *= np.sign(rotation[:, :1])
    rest = random.uniform(-0.9, 0.9, (count, (degree + 1) ** 2 - 1, 3)) if degree else None
    return Gaussians(
        mean=random.uniform(-2, 2, (count, 3)).astype(np.float32),
        scale=random.uniform(-5, -2, (count, axes)).astype(np.float32),
        rotation=rotation.astype(np.float32),
        opacity=random.uniform(-3, 3, count).astype(np.float32),
        f_dc=random.uniform(-1.5, 1.5, (count, 3)).astype(np.float32),
        f_rest=None if rest is None else rest.astype(np.float32),
    )


def alpha(model: Gaussians) -> np.ndarray:
    return 1 / (1 + np.exp(-model.opacity.astype(np.float64)))


def to_bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


# ---- PLY


def ply(
    model: Gaussians, *, comment: str = "", order: str = "binary_little_endian", byte_colors: bool = False
) -> bytes:
    """Return the PLY of a training; with `byte_colors` as exporters of models without SH write it."""
    columns: dict[str, np.ndarray] = {axis: model.mean[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"n{axis}": np.zeros(len(model.mean)) for axis in "xyz"}
    if byte_colors:
        color = to_bytes(255 * (0.5 + SH_C0 * model.f_dc))
        columns |= {name: color[:, k] for k, name in enumerate(("red", "green", "blue"))}
    else:
        columns |= {f"f_dc_{k}": model.f_dc[:, k] for k in range(3)}
    if model.f_rest is not None:
        flat = model.f_rest.transpose(0, 2, 1).reshape(len(model.mean), -1)
        columns |= {f"f_rest_{k}": flat[:, k] for k in range(flat.shape[1])}
    columns["opacity"] = model.opacity
    columns |= {f"scale_{k}": model.scale[:, k] for k in range(model.scale.shape[1])}
    columns |= {f"rot_{k}": model.rotation[:, k] for k in range(4)}
    kinds = {name: "uchar" if array.dtype == np.uint8 else "float" for name, array in columns.items()}
    lines = ["ply", f"format {order} 1.0", *([f"comment {comment}"] if comment else [])]
    lines += [f"element vertex {len(model.mean)}"]
    lines += [f"property {kind} {name}" for name, kind in kinds.items()] + ["end_header\n"]
    head = "\n".join(lines).encode()
    if order == "ascii":
        rows = np.column_stack([array.astype(np.float64) for array in columns.values()])
        return head + "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()
    sign = "<" if order == "binary_little_endian" else ">"
    dtype = np.dtype([(name, sign + ("u1" if kinds[name] == "uchar" else "f4")) for name in columns])
    table = np.zeros(len(model.mean), dtype)
    for name, array in columns.items():
        table[name] = array
    return head + table.tobytes()


def compressed_ply(model: Gaussians) -> bytes:
    """Return SuperSplat's compressed PLY: chunks of 256, with bounds of positions, scales and colours."""
    count, chunks = len(model.mean), -(-len(model.mean) // 256)
    color = 0.5 + SH_C0 * model.f_dc.astype(np.float64)
    values = {"": model.mean, "scale_": model.scale, "rgb": color}
    axes = {"": "xyz", "scale_": "xyz", "rgb": "rgb"}
    bounds, shares = {}, {}
    for name, array in values.items():
        low = np.stack([array[256 * k : 256 * k + 256].min(axis=0) for k in range(chunks)])
        high = np.stack([array[256 * k : 256 * k + 256].max(axis=0) for k in range(chunks)])
        number = np.arange(count) // 256
        shares[name] = (array - low[number]) / (high - low)[number]
        stem = "" if name == "rgb" else name
        for k, axis in enumerate(axes[name]):
            bounds[f"min_{stem}{axis}"], bounds[f"max_{stem}{axis}"] = low[:, k], high[:, k]

    def pack(parts: np.ndarray, *widths: int) -> np.ndarray:
        word = np.zeros(count, np.uint32)
        for k, width in enumerate(widths):
            word = word << np.uint32(width) | np.round(parts[:, k] * (2**width - 1)).astype(np.uint32)
        return word

    largest = np.abs(model.rotation).argmax(axis=1)
    unit = model.rotation * np.sign(np.take_along_axis(model.rotation, largest[:, None], 1))
    others = np.stack([np.delete(row, left) for row, left in zip(unit, largest, strict=True)])
    packed = pack(np.column_stack([largest / 3, others / np.sqrt(2) + 0.5]), 2, 10, 10, 10)
    table = np.zeros(count, [(f"packed_{n}", "<u4") for n in ("position", "rotation", "scale", "color")])
    table["packed_position"] = pack(shares[""], 11, 10, 11)
    table["packed_rotation"] = packed
    table["packed_scale"] = pack(shares["scale_"], 11, 10, 11)
    table["packed_color"] = pack(np.column_stack([shares["rgb"], alpha(model)]), 8, 8, 8, 8)
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in bounds] + [f"element vertex {count}"]
    lines += [f"property uint {name}" for name in table.dtype.names]
    body = np.column_stack(list(bounds.values())).astype("<f4").tobytes() + table.tobytes()
    if model.f_rest is not None:
        flat = model.f_rest.transpose(0, 2, 1).reshape(count, -1)
        lines += [f"element sh {count}"] + [f"property uchar f_rest_{k}" for k in range(flat.shape[1])]
        body += to_bytes((flat / 8 + 0.5) * 256 - 0.5).tobytes()
    return ("\n".join([*lines, "end_header\n"])).encode() + body


# ---- plain bytes


def splat(model: Gaussians) -> bytes:
    row = [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]
    table = np.zeros(len(model.mean), row)
    table["mean"], table["scale"] = model.mean, np.exp(model.scale)
    table["rgba"] = to_bytes(255 * np.column_stack([0.5 + SH_C0 * model.f_dc, alpha(model)]))
    table["rotation"] = to_bytes(128 * model.rotation + 128)
    return table.tobytes()


def spz(model: Gaussians, version: int = 2, *, antialiased: bool = False) -> bytes:
    """Return an .spz file of version 1 to 4; fixed point with 12 bits."""
    count, degree = len(model.mean), model.degree
    mean = model.mean * FLIP
    if version == 1:
        positions = mean.astype("<f2").tobytes()
    else:
        fixed = np.round(mean * 4096).astype("<i4")
        positions = np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    xyzw = np.column_stack([model.rotation[:, 1:] * FLIP, model.rotation[:, 0]])
    if version < 3:
        rotations = to_bytes(xyzw[:, :3] * 127.5 + 127.5).tobytes()
    else:
        words = []
        for q in xyzw.astype(float):
            left = int(np.abs(q).argmax())
            q, word = q * np.sign(q[left]), left
            for k in range(4):
                if k != left:
                    word = word << 10 | int(q[k] < 0) << 9 | round(511 * abs(q[k]) * np.sqrt(2))
            words.append(word)
        rotations = np.array(words, "<u4").tobytes()
    columns = [
        positions,
        to_bytes(255 * alpha(model)).tobytes(),
        to_bytes(255 * (0.5 + 0.15 * model.f_dc)).tobytes(),
        to_bytes(16 * (model.scale + 10)).tobytes(),
        rotations,
    ]
    if model.f_rest is not None:
        signs = SH_FLIP[: model.f_rest.shape[1], None]
        columns.append(to_bytes(128 + 128 * model.f_rest * signs).tobytes())
    header = struct.pack("<IIIBBB", 0x5053474E, version, count, degree, 12, antialiased)
    if version < 4:
        return gzip.compress(header + b"\0" + b"".join(columns), 6, mtime=0)
    import zstandard

    packed = [zstandard.ZstdCompressor().compress(column) for column in columns]
    table = b"".join(struct.pack("<QQ", len(p), len(c)) for p, c in zip(packed, columns, strict=True))
    return header + bytes([len(packed)]) + struct.pack("<I12x", 32) + table + b"".join(packed)


# ---- SOG


def webp(texels: np.ndarray) -> bytes:
    """Return a lossless WebP of texels (N, 3 | 4), in rows of 32 texels."""
    rows = -(-len(texels) // 32)
    image = np.zeros((rows * 32, texels.shape[1]), np.uint8)
    image[: len(texels)] = texels
    return encode(image.reshape(rows, 32, -1))


def encode(image: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def sog_files(model: Gaussians, version: int = 2) -> dict[str, bytes]:
    """Return the files of a SOG model by name."""
    count = len(model.mean)
    drawn = np.sign(model.mean) * np.log1p(np.abs(model.mean))
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    level = np.round((drawn - low) / (high - low) * 65535).astype(np.int64)
    largest = np.abs(model.rotation).argmax(axis=1)
    unit = model.rotation * np.sign(np.take_along_axis(model.rotation, largest[:, None], 1))
    others = np.stack([np.delete(row, left) for row, left in zip(unit, largest, strict=True)])
    quats = np.column_stack([to_bytes((others * np.sqrt(2) + 1) / 2 * 255), largest + 252])
    files = {
        "means_l.webp": webp(level & 255),
        "means_u.webp": webp(level >> 8),
        "quats.webp": webp(quats.astype(np.uint8)),
    }
    means = {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}
    meta: dict[str, Any] = {"means": means, "quats": {"files": ["quats.webp"]}}
    scale_range, color_range = (-6.0, -1.0), (-2.0, 2.0)

    def shares(values: np.ndarray, bounds: tuple[float, float]) -> np.ndarray:
        return to_bytes(255 * (values - bounds[0]) / (bounds[1] - bounds[0]))

    scales, colors = shares(model.scale, scale_range), shares(model.f_dc, color_range)
    files["scales.webp"] = webp(scales)
    if version == 2:
        meta |= {"version": 2, "count": count}
        codebooks = {
            n: np.linspace(*r, 256).tolist() for n, r in (("scales", scale_range), ("sh0", color_range))
        }
        meta |= {name: {"codebook": book, "files": [f"{name}.webp"]} for name, book in codebooks.items()}
        files["sh0.webp"] = webp(np.column_stack([colors, to_bytes(255 * alpha(model))]))
    else:
        means["shape"] = [count, 3]
        meta["scales"] = {"mins": [-6.0] * 3, "maxs": [-1.0] * 3, "files": ["scales.webp"]}
        logits = shares(model.opacity, (-4.0, 4.0))
        bounds = {"mins": [-2.0] * 3 + [-4.0], "maxs": [2.0] * 3 + [4.0]}
        meta["sh0"] = {**bounds, "files": ["sh0.webp"]}
        files["sh0.webp"] = webp(np.column_stack([colors, logits]))
    if model.f_rest is not None:
        # Entry i of the palette belongs to Gaussian i; rows have 64 entries.
        coefficients = model.f_rest.shape[1]
        palette = np.zeros((-(-count // 64) * 64, coefficients, 3), np.uint8)
        palette[:count] = shares(model.f_rest, (-1.0, 1.0))
        files["shN_centroids.webp"] = encode(palette.reshape(-1, 64 * coefficients, 3))
        label = np.arange(count)
        files["shN_labels.webp"] = webp(np.column_stack([label & 255, label >> 8, 0 * label]))
        names = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"files": names, "mins": -1.0, "maxs": 1.0}
        if version == 2:
            meta["shN"] = {
                "files": names,
                "codebook": np.linspace(-1, 1, 256).tolist(),
                "bands": model.degree,
            }
    return {"meta.json": json.dumps(meta).encode(), **files}


def sog(model: Gaussians, version: int = 2) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in sog_files(model, version).items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


# ---- GLB


def glb(model: Gaussians, *, node: dict[str, Any] | None = None, drop: str = "") -> bytes:
    """Return a GLB with the extension KHR_gaussian_splatting; `drop` leaves out an attribute."""
    ext = "KHR_gaussian_splatting"
    arrays: dict[str, np.ndarray] = {
        "POSITION": model.mean * FLIP,
        f"{ext}:ROTATION": np.column_stack([model.rotation[:, 1:] * FLIP, model.rotation[:, 0]]),
        f"{ext}:SCALE": model.scale,
        f"{ext}:OPACITY": alpha(model)[:, None],
        f"{ext}:SH_DEGREE_0_COEF_0": model.f_dc,
    }
    if model.f_rest is not None:
        rest = model.f_rest * SH_FLIP[: model.f_rest.shape[1], None]
        for k in range(rest.shape[1]):
            degree = int(np.sqrt(k + 1))
            arrays[f"{ext}:SH_DEGREE_{degree}_COEF_{k + 1 - degree**2}"] = rest[:, k]
    arrays.pop(drop, None)
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    accessors, views, body = [], [], b""
    for k, array in enumerate(arrays.values()):
        data = array.astype("<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data)})
        accessor: dict[str, Any] = {"bufferView": k, "componentType": 5126, "count": len(array)}
        accessors.append({**accessor, "type": kinds[array.shape[1]]})
        body += data
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {
        "attributes": {name: k for k, name in enumerate(arrays)},
        "mode": 0,
        "extensions": {ext: extension},
    }
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [ext],
        "buffers": [{"byteLength": len(body)}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    return glb_file(json.dumps(document).encode(), body)


FILES: dict[str, Callable[[int], bytes]] = {
    "three.ply": lambda count: ply(gaussians(3, count=count)),
    "four.ply": lambda count: ply(gaussians(4, count=count)),
    "text.ply": lambda count: ply(gaussians(1, count=count), order="ascii"),
    "big_endian.ply": lambda count: ply(gaussians(2, count=count), order="binary_big_endian"),
    "discs.ply": lambda count: ply(gaussians(1, 2, count=count)),
    "small.compressed.ply": lambda count: compressed_ply(gaussians(0, count=count)),
    "sh.compressed.ply": lambda count: compressed_ply(gaussians(2, count=count)),
    "a.splat": lambda count: splat(gaussians(0, count=count)),
    "v1.spz": lambda count: spz(gaussians(0, count=count), 1),
    "v2.spz": lambda count: spz(gaussians(1, count=count), 2),
    "v3.spz": lambda count: spz(gaussians(3, count=count), 3),
    "v4.spz": lambda count: spz(gaussians(2, count=count), 4),
    "v1.sog": lambda count: sog(gaussians(1, count=count), 1),
    "v2.sog": lambda count: sog(gaussians(3, count=count), 2),
    "a.glb": lambda count: glb(gaussians(3, count=count)),
}
"""File name -> content of a valid file with a number of Gaussians; `MODELS` has their degree and axes."""
MODELS: dict[str, tuple[int, int]] = {
    "three.ply": (3, 3),
    "four.ply": (4, 3),
    "text.ply": (1, 3),
    "big_endian.ply": (2, 3),
    "discs.ply": (1, 2),
    "small.compressed.ply": (0, 3),
    "sh.compressed.ply": (2, 3),
    "a.splat": (0, 3),
    "v1.spz": (0, 3),
    "v2.spz": (1, 3),
    "v3.spz": (3, 3),
    "v4.spz": (2, 3),
    "v1.sog": (1, 3),
    "v2.sog": (3, 3),
    "a.glb": (3, 3),
}
