"""The dedicated tier's pipeline, stage by stage, on synthetic models of the sizes captures have.

    python -m benchmarks.dedicated                           all methods, 100k to 3M faces, both image sizes
    python -m benchmarks.dedicated --faces 100000 --method two_dts
    python -m benchmarks.dedicated --blend                   the blend stage against other ways to do it

Models: faces scattered about three layers of surface at depths 3, 6 and 12, with sizes of a log-normal
distribution (the median shrinks as one over the square root of their number: about 3 pixels at 1M faces and
1237 x 822) and opacities of a U-shaped beta distribution, most of them nearly opaque. SH degree 3. What is
compared takes turns, so a machine whose speed drifts treats all alike; figures are the least of the rounds.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.measure import machine

if TYPE_CHECKING:
    from msb.asset import Asset

SIZES = ((620, 411), (1237, 822))
FACES = (100_000, 300_000, 1_000_000, 3_000_000)
_FOCAL = 1160 / 1237
"""Focal length as a share of the image's width."""


def camera(width: int, height: int) -> Any:
    """Return the camera all models are made for: at the origin, along z."""
    import msb

    return msb.Camera(width, height, _FOCAL * width, _FOCAL * width, width / 2, height / 2, np.eye(4))


def soup(faces: int, seed: int = 0) -> dict[str, Any]:
    """Return positions (F, 3, 3), opacities and SH coefficients of free triangles."""
    random = np.random.default_rng(seed)
    # Half as wide again as the image: as in a capture, much of the model is out of view.
    x = random.uniform(-0.8, 0.8, faces)
    y = random.uniform(-0.55, 0.55, faces)
    layer = random.choice([3.0, 6.0, 12.0], faces, p=[0.35, 0.35, 0.3])
    z = layer * (1 + 0.15 * np.sin(5 * x + layer) * np.cos(4 * y)) + 0.05 * random.standard_normal(faces)
    radius = 3 * np.sqrt(1e6 / faces) / 1160 * np.exp(0.8 * random.standard_normal(faces)) * z
    center = np.stack([x * z, y * z, z], axis=1)
    corners = random.standard_normal((faces, 3, 3)) * np.array([1, 1, 0.5])
    corners -= corners.mean(axis=1, keepdims=True)
    positions = center[:, None] + corners * radius[:, None, None]
    opacity = np.clip(random.beta(1.2, 0.5, faces), 1e-3, 1 - 1e-4)
    return {
        "positions": positions.reshape(-1, 3).astype(np.float32),
        "indices": np.arange(3 * faces, dtype=np.uint32).reshape(-1, 3),
        "opacity": np.log(opacity / (1 - opacity)).astype(np.float32),
        "f_dc": random.normal(0, 0.8, (faces, 3)).astype(np.float32),
        "f_rest": random.normal(0, 0.1, (faces, 45)).astype(np.float32),
    }


def grid_mesh(faces: int, seed: int = 0) -> dict[str, Any]:
    """Return three layers of bumpy grids with shared vertices: what MeshSplatting makes."""
    random = np.random.default_rng(seed)
    side = max(2, round((faces / 6) ** 0.5))
    u, v = np.meshgrid(np.linspace(-0.8, 0.8, side + 1), np.linspace(-0.55, 0.55, side + 1))
    cell = np.arange(side)[:, None] * (side + 1) + np.arange(side)
    quads = np.stack([cell, cell + 1, cell + side + 2, cell + side + 1], axis=-1).reshape(-1, 4)
    positions, indices = [], []
    for number, depth in enumerate((3.0, 6.0, 12.0)):
        z = depth * (1 + 0.15 * np.sin(5 * u + depth) * np.cos(4 * v))
        z = z + 0.002 * depth * random.standard_normal(z.shape)
        positions.append(np.stack([u * z, v * z, z], axis=-1).reshape(-1, 3))
        # A third of the nearer layers is holes, through which the next one is seen.
        kept = quads if depth == 12.0 else quads[np.sin(40 * quads[:, 0] / side) > -0.5]
        indices.append(np.concatenate([kept[:, :3], kept[:, [0, 2, 3]]]) + number * (side + 1) ** 2)
    vertices = 3 * (side + 1) ** 2
    return {
        "positions": np.concatenate(positions).astype(np.float32),
        "indices": np.ascontiguousarray(np.concatenate(indices), np.uint32),
        "opacity": np.full(vertices, 4.0, np.float32),
        "f_dc": random.normal(0, 0.8, (vertices, 3)).astype(np.float32),
        "f_rest": random.normal(0, 0.1, (vertices, 45)).astype(np.float32),
    }


def model(method: str, faces: int) -> Asset:
    """Return an asset of `method` with about so many faces."""
    from msb.asset.build import Description, build_asset

    buffers = grid_mesh(faces) if method == "mesh_splatting" else soup(faces)
    kernel: dict[str, Any] = {"kernel": "gaussian_power"}
    if method == "triangle_splatting":
        sigma = np.exp(0.15 + 0.5 * np.random.default_rng(1).standard_normal(faces))
        buffers["sigma"] = np.log(sigma).astype(np.float32)
        kernel = {"kernel": "incentre_window", "sigma_encoding": "exp", "sigma_offset": 0.01}
    elif method == "mesh_splatting":
        kernel = {"kernel": "edge_window"}
    domain = "vertex" if method == "mesh_splatting" else "face"
    description = Description(
        method=method,
        sh_degree=3,
        coverage=kernel,
        opacity={"encoding": "logit"},
        appearance={"kind": "spherical_harmonics", "f_rest_order": "coefficient_major"},
        compositing={"kind": "front_to_back"},
    )
    domains: dict[str, Any] = dict.fromkeys(buffers.keys() - {"positions", "indices"}, domain)
    return build_asset(buffers, domains, description)


def stages(method: str, faces: int, rounds: int, device: str | None) -> list[dict[str, Any]]:
    """Return the milliseconds of every stage at both image sizes."""
    from msb.cl import open_device
    from msb.render.splatting import SplattingPipeline

    asset, found = model(method, faces), []
    with open_device(device) as opened:
        pipeline = SplattingPipeline(asset, device=opened, outputs=())
        for width, height in SIZES:
            view = camera(width, height)
            pipeline.draw(view, (0, 0, 0))
            drawn = [pipeline.draw(view, (0, 0, 0)) for _ in range(rounds)]
            names = list(drawn[0].stages)
            took = {name: min(d.stages[name] for d in drawn) for name in names}
            total = sum(took.values())
            found.append(
                {
                    "method": method,
                    "faces": asset.manifest.face_count,
                    "size": f"{width}x{height}",
                    **pipeline.counts,
                    "ms": took,
                    "total": total,
                    "span": min(d.span for d in drawn),
                    "project+sort+bin": sum(took[name] for name in ("project", "sort", "bin")) / total,
                }
            )
        pipeline.close()
    return found


C_LOOP = r"""
// The blend stage of 2DTS (2D rasterizer, gamma 1) by hand: the same lists, the same faces, the same planes.
#include <immintrin.h>
#include <math.h>
#include <stdint.h>
typedef float v8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
typedef long long l4 __attribute__((vector_size(32)));
typedef struct {
    float x[3], y[3], inverse, z[3], normal[3], opacity, limit, color[3];
    int x0, y0, x1, y1;
} Face;
static inline int any(i8 m) { l4 q = (l4)m; return (q[0] | q[1] | q[2] | q[3]) != 0; }
static inline v8 all(float s) { return s - (v8){}; }
static inline v8 where(i8 m, v8 a, v8 b) { return (v8)(((i8)a & m) | ((i8)b & ~m)); }
static inline v8 exp2_fast(v8 x) {
    v8 shifted = x + 12582912.0f, f = x - (shifted - 12582912.0f);
    v8 p = f * 1.5345812e-4f + 1.3399931e-3f;
    p = p * f + 9.6184891e-3f; p = p * f + 5.5503286e-2f; p = p * f + 2.4022646e-1f;
    p = p * f + 6.9314718e-1f; p = p * f + 1.0f;
    return p * (v8)(((i8)shifted + 127) << 23);
}
static inline v8 smaller(v8 a, v8 b) { return (v8)_mm256_min_ps((__m256)a, (__m256)b); }
typedef struct { v8 e, a1, a2, alpha; } Sample;
static inline i8 inside(const Face *f, const v8 *x, float y, Sample *s) {
    float y1 = f->y[0] - y, y2 = f->y[1] - y, y3 = f->y[2] - y;
    s->a1 = (x[1] * y3 - y2 * x[2]) * f->inverse;
    s->a2 = (x[2] * y1 - y3 * x[0]) * f->inverse;
    s->e = 1.0f - 3.0f * smaller(smaller(s->a1, s->a2), 1.0f - s->a1 - s->a2);
    return (s->e >= 0.0f) & (s->e <= f->limit);
}
static inline i8 cover(const Face *f, i8 m, Sample *s) {
    v8 g = s->e * s->e * -0.72134752f;
    s->alpha = smaller(all(0.99f), f->opacity * exp2_fast((v8)_mm256_max_ps((__m256)g, (__m256)all(-100))));
    return m & (s->alpha >= 1.0f / 255.0f);
}
typedef struct { v8 t, red, green, blue, z; } State;
static inline void row(State *p, const Face *f, i8 hit, const Sample *s) {
    v8 before = p->t;
    i8 m = hit & (before > 1e-4f);
    v8 w = where(m, s->alpha * before, (v8){});
    p->t = where(m, before * (1.0f - s->alpha), before);
    p->red += f->color[0] * w; p->green += f->color[1] * w; p->blue += f->color[2] * w;
    p->z += ((1.0f - s->a1 - s->a2) * f->z[2] + s->a2 * f->z[1] + s->a1 * f->z[0]) * w;
}
static inline i8 reaches(const Face *f, float left, v8 y) {
    i8 found = ~(i8){};
    float wide = fabsf(f->x[0] - left) + fabsf(f->x[1] - left) + fabsf(f->x[2] - left) + 8;
    float tall = fabsf(f->y[0] - y[0]) + fabsf(f->y[1] - y[0]) + fabsf(f->y[2] - y[0]) + 16;
    float least = (1 - f->limit) / 3 - 1e-4f - 1e-6f * wide * tall * fabsf(f->inverse);
    for (int k = 0; k < 3; k++) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1;
        float sx = (f->y[i] - f->y[j]) * f->inverse, sy = (f->x[j] - f->x[i]) * f->inverse;
        float most = 7 * fmaxf(sx, 0) + fmaxf(sy, 0);
        v8 at = ((f->x[i] - left) * (f->y[j] - y) - (f->y[i] - y) * (f->x[j] - left)) * f->inverse;
        found &= ~(at + most < least);
    }
    return found;
}
void blend(const uint64_t *starts, const uint32_t *list, const Face *faces, float *planes, int width,
           int height, int columns, int rows) {
    const v8 lane = {0, 1, 2, 3, 4, 5, 6, 7};
    const i8 bit = {1, 2, 4, 8, 16, 32, 64, 128};
#pragma omp parallel for schedule(dynamic, 4)
    for (int tile = 0; tile < columns * rows; tile++) {
        int left = tile % columns * 16, top = tile / columns * 16;
        State state[2][16];
        unsigned alive[2];
        for (int h = 0; h < 2; h++) {
            v8 x = lane + (float)(left + 8 * h);
            alive[h] = left + 8 * h < width ? 0xff : 0;
            if (top + 16 > height) alive[h] &= (1u << (height - top + 1) / 2) - 1;
            for (int r = 0; r < 16; r++) {
                state[h][r] = (State){};
                i8 there = (x < (float)width) & (all(top + r) < (float)height);
                state[h][r].t = where(there, all(1), all(-1));
            }
        }
        for (uint64_t e = starts[tile], end = starts[tile + 1]; e < end && (alive[0] | alive[1]); e++) {
            const Face *f = faces + list[e];
            const char *next = (const char *)(faces + list[e + 4 < end ? e + 4 : end - 1]);
            __builtin_prefetch(next); __builtin_prefetch(next + 64);
            int y0 = (f->y0 > top ? f->y0 - top : 0) / 2, y1 = (f->y1 - top < 15 ? f->y1 - top : 15) / 2;
            if (f->y1 < top || y0 > y1) continue;
            unsigned pairs = (0xffu >> (7 - y1)) & (0xffu << y0);
            for (int h = 0; h < 2; h++) {
                int from = left + 8 * h;
                if (!(alive[h] & pairs) || f->x1 < from || f->x0 > from + 7) continue;
                l4 q = (l4)(reaches(f, from, (float)top + 2.0f * lane) & bit);
                uint64_t b = q[0] | q[1] | q[2] | q[3];
                unsigned todo = alive[h] & pairs & (unsigned)(b | b >> 32);
                v8 x = lane + (float)from, c[3] = {f->x[0] - x, f->x[1] - x, f->x[2] - x};
                for (; todo; todo &= todo - 1) {
                    int k = __builtin_ctz(todo);
                    float y = top + 2 * k;
                    Sample s, u;
                    i8 m = inside(f, c, y, &s), n = inside(f, c, y + 1, &u);
                    if (!any(m | n)) continue;
                    m = cover(f, m, &s), n = cover(f, n, &u);
                    if (!any(m | n)) continue;
                    State *p = &state[h][2 * k];
                    row(p, f, m, &s), row(p + 1, f, n, &u);
                    if (!any((p[0].t > 1e-4f) | (p[1].t > 1e-4f))) alive[h] &= ~(1u << k);
                }
            }
        }
        long stride = 16L * columns, plane = stride * 16 * rows;
        for (int r = 0; r < 16; r++)
            for (int h = 0; h < 2; h++) {
                float *out = planes + (top + r) * stride + left + 8 * h;
                State *p = &state[h][r];
                p->t = where(p->t < 0.0f, -p->t, p->t);
                *(v8 *)out = p->red; *(v8 *)(out + plane) = p->green; *(v8 *)(out + 2 * plane) = p->blue;
                *(v8 *)(out + 3 * plane) = p->t; *(v8 *)(out + 4 * plane) = p->z;
            }
    }
}
"""


def c_loop(folder: Path) -> Any:
    """Return `C_LOOP` compiled, or None where there is no C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    source, library = folder / "blend.c", folder / "blend.so"
    source.write_text(C_LOOP)
    flags = ["-O3", "-mavx2", "-mfma", "-fopenmp", "-shared", "-fPIC", "-lm"]
    subprocess.run([compiler, str(source), "-o", str(library), *flags], check=True)
    return ctypes.CDLL(str(library)).blend


def blends(faces: int, rounds: int, folder: Path) -> list[dict[str, Any]]:
    """Return the milliseconds of 2DTS's blend stage and of other ways to do the same, taking turns."""
    from msb.cl import open_device
    from msb.render.splatting import SplattingPipeline

    asset, by_hand, found = model("two_dts", faces), c_loop(folder), []
    with open_device("cpu") as cpu, open_device("cpu", style="gpu") as gpu, open_device("cpu") as whole:
        ours = SplattingPipeline(asset, device=cpu, outputs=())
        ways: dict[str, Any] = {
            "ours": ours,
            "work-groups": SplattingPipeline(asset, device=gpu, outputs=()),
            "no early stop": SplattingPipeline(asset, device=whole, outputs=(), early_stop=False),
        }
        for width, height in SIZES:
            view = camera(width, height)
            image = ours.render(view, (0, 0, 0)).image
            columns, rows = -(-width // 16), -(-height // 16)
            pairs = ours.counts["pairs"]
            starts = cpu.scratch("splat tile starts", columns * rows + 1, np.uint64).read()
            lists = cpu.scratch("splat tile lists", pairs, np.uint32).read()
            records = cpu.scratch("splat faces", (faces, 22), np.uint32).read()
            # Vectors are stored to it: on a boundary of 32 bytes.
            memory = np.zeros(5 * rows * columns * 256 + 8, np.float32)
            planes = memory[-memory.ctypes.data % 32 // 4 :][: memory.size - 8]
            took: dict[str, list[float]] = {name: [] for name in (*ways, *(["C"] if by_hand else []))}
            for _ in range(rounds + 1):
                for name, pipeline in ways.items():
                    took[name].append(pipeline.draw(view, (0, 0, 0)).stages["blend"])
                if by_hand:
                    pointers = (ctypes.c_void_p(a.ctypes.data) for a in (starts, lists, records, planes))
                    begun = time.perf_counter()
                    by_hand(*pointers, width, height, columns, rows)
                    took["C"].append(1e3 * (time.perf_counter() - begun))
            if by_hand:  # the same image, or the comparison says nothing
                same = planes.reshape(5, 16 * rows, 16 * columns)[:3, :height, :width].transpose(1, 2, 0)
                assert np.abs(same - image).max() < 2e-3
            fastest = {name: min(values[1:]) for name, values in took.items()}
            found.append({"faces": faces, "size": f"{width}x{height}", "pairs": pairs, "ms": fastest})
        for pipeline in ways.values():
            pipeline.close()
    return found


def print_blends(rows: list[dict[str, Any]]) -> None:
    """Print one line a model and image size."""
    names = list(rows[0]["ms"])
    print(f"{'faces':>8} {'size':>9} {'pairs':>9}", *(f"{name:>14}" for name in names), "  ours / C")
    for row in rows:
        ratio = f"{row['ms']['ours'] / row['ms']['C']:10.2f}" if "C" in names else ""
        times = (f"{row['ms'][name]:14.1f}" for name in names)
        print(f"{row['faces']:8} {row['size']:>9} {row['pairs']:9}", *times, ratio)


def print_stages(rows: list[dict[str, Any]]) -> None:
    """Print one line a model and image size."""
    head = ("project", "sort", "bin", "blend", "resolve")
    print(
        f"{'method':20} {'faces':>8} {'size':>9} {'listed':>8} {'pairs':>9}",
        *(f"{n:>8}" for n in head),
        end="",
    )
    print(f" {'total':>8} {'p+s+b':>6}")
    for row in rows:
        print(
            f"{row['method']:20} {row['faces']:8} {row['size']:>9} {row['listed']:8} {row['pairs']:9}",
            *(f"{row['ms'][name]:8.1f}" for name in head),
            f"{row['total']:8.1f} {row['project+sort+bin']:6.0%}",
        )


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--faces", type=int, nargs="+", default=FACES)
    methods = ("two_dts", "triangle_splatting", "mesh_splatting")
    parser.add_argument("--method", nargs="+", choices=methods, default=methods)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--blend", action="store_true", help="the blend stage alone, against other ways")
    parser.add_argument("--device", help="as MSB_DEVICE")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    record: dict[str, Any] = {"machine": machine("numpy", "pyopencl", "pocl-binary-distribution")}
    print("\n".join(f"{key}: {value}" for key, value in record["machine"].items()))
    rows: list[dict[str, Any]] = []
    if options.blend:
        with tempfile.TemporaryDirectory() as name:
            for faces in options.faces:
                rows += blends(faces, options.rounds, Path(name))
                print_blends(rows[-len(SIZES) :])
        record["blend"] = rows
        options.method = ()
    for method in options.method:
        for faces in options.faces:
            rows += stages(method, faces, options.rounds, options.device)
            print_stages(rows[-len(SIZES) :])
    if not options.blend:
        record["stages"] = rows
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
