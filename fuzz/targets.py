"""Every reader of the package as a fuzz target, by name."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from fuzz import readers, seeds
from fuzz.target import Target
from msb.meshes import MESH_SUFFIXES
from msb.registry import METHODS
from tests.adapters import assemble, models
from tests.meshes.builders import OBJ_TEXTURED, picture
from tests.scenes.bad_cameras import SMALL as CAMERAS


def model_target(method: str) -> Target:
    """Return the target of one adapter: a hostile program in a valid archive.

    Methods without a small torch file read meshes.
    """
    if method not in models.VALUES:
        return Target(
            lambda path: readers.export(path, method), lambda: seeds.meshes(".ply"), "point_cloud.ply"
        )
    return Target(
        readers.export,
        lambda: [seeds.model(method)[0]],
        models.place(method),
        wrap=lambda data: assemble.archive(data, seeds.model(method)[1]),
    )


def web_target(name: str) -> Target:
    """Return the target of one file of a DiffSoup web export. The other files are valid."""
    beside = {other: content for other, content in seeds.web_export().items() if other != name}
    return Target(
        lambda path: readers.export(path.parent), lambda: [seeds.web_export()[name]], name, beside=beside
    )


def splat_target(name: str, *files: str) -> Target:
    """Return the target of a format of Gaussian splats; `files` are seeds."""
    return Target(readers.export, lambda: seeds.splats(*files), name)


def mesh_target(suffix: str) -> Target:
    """Return the target of a mesh format."""
    return Target(readers.mesh, lambda: seeds.meshes(suffix), f"mesh{suffix}")


def camera_target(kind: str, file: str, read: Callable[[Path], None] = readers.camera_folder) -> Target:
    """Return the target of one file of a camera source. The other files of this `kind` are valid."""

    beside = {name: data for name, data in CAMERAS[kind].items() if name != file}
    return Target(read, lambda: seeds.cameras(kind, file), file, beside=beside)


def dtu_target(file: str) -> Target:
    """Return the target of one file of DTU's evaluation data. The other files are valid."""
    files = seeds.dtu_files()
    return Target(
        readers.dtu, lambda: [files[file]], file, beside={n: data for n, data in files.items() if n != file}
    )


NERF = "scenes/nerf_synthetic/pebble/transforms_test.json"

TARGETS: dict[str, Target] = {
    "triasset": Target(readers.asset, seeds.assets, "a.triasset"),
    "triasset_manifest": Target(readers.asset, seeds.manifests, "a.triasset", wrap=seeds.around_manifest),
    "checkpoint": Target(readers.checkpoint, seeds.checkpoints, "a.pt"),
    "checkpoint_pickle": Target(readers.checkpoint, seeds.pickles, "a.pt", wrap=assemble.archive),
    **{f"model_{method}": model_target(method) for method in METHODS},
    "splats_ply": splat_target("a.ply", "three.ply", "text.ply", "big_endian.ply", "discs.ply"),
    "splats_compressed_ply": splat_target("a.ply", "small.compressed.ply", "sh.compressed.ply"),
    "splats_rows": splat_target("a.splat", "a.splat"),
    "splats_spz": splat_target("a.spz", "v1.spz", "v2.spz", "v3.spz", "v4.spz"),
    "splats_spz_columns": Target(readers.export, seeds.spz_columns, "a.spz", wrap=gzip.compress),
    "splats_sog": splat_target("a.sog", "v1.sog", "v2.sog"),
    "splats_sog_meta": Target(readers.export, seeds.sog_texts, "a.sog", wrap=seeds.around_meta),
    "splats_glb": splat_target("a.glb", "a.glb"),
    "web_texture": web_target("lut0.png"),
    "web_weights": web_target("mlp_weights.json"),
    "web_meta": web_target("meta.json"),
    "cfg_args": Target(readers.cfg_args, seeds.stub("models/pebble/mesh_splatting/cfg_args"), "cfg_args"),
    "two_dts_yaml": Target(readers.two_dts_config, seeds.configs, "config.yaml"),
    "two_dts_log": Target(readers.two_dts_config, seeds.configs, "a.log", wrap=seeds.log),
    **{suffix[1:]: mesh_target(suffix) for suffix in MESH_SUFFIXES if not suffix.startswith(".usd")},
    "glb_json": Target(readers.mesh, seeds.glb_texts, "mesh.glb", wrap=seeds.around_gltf),
    "colmap_cameras_bin": camera_target("binary", "cameras.bin"),
    "colmap_images_bin": camera_target("binary", "images.bin"),
    "colmap_points_bin": camera_target("points3D.bin", "points3D.bin", readers.points),
    "colmap_cameras_txt": camera_target("text", "cameras.txt"),
    "colmap_images_txt": camera_target("text", "images.txt"),
    "colmap_points_txt": camera_target("points3D.txt", "points3D.txt", readers.points),
    "transforms_json": camera_target("transforms.json", "transforms.json"),
    "nerf_json": Target(readers.cameras, seeds.stub(NERF), "transforms_test.json"),
    "cameras_json": camera_target("cameras.json", "cameras.json"),
    "views_json": camera_target("views.json", "views.json", readers.views),
    "neus_npz": Target(readers.neus, seeds.matrices, "cameras.npz"),
    "image_png": Target(readers.image, lambda: seeds.pictures("png"), "a.png"),
    "image_jpeg": Target(readers.image, lambda: seeds.pictures("jpg"), "a.jpg"),
    "glb_packed": Target(readers.mesh, seeds.packed, "mesh.glb"),
    "mtl": Target(
        readers.materials, seeds.materials, "a.mtl", beside={"a.obj": OBJ_TEXTURED, "map.png": picture()}
    ),
    "texture": Target(
        readers.texture,
        lambda: [each for kind in ("png", "jpg", "webp") for each in seeds.pictures(kind)],
        "a.img",
    ),
    "image_npy": Target(readers.image, seeds.npy_images, "a.npy"),
    "image_exr": Target(readers.image, seeds.exr_images, "a.exr"),
    "image_mask": Target(readers.mask, lambda: seeds.pictures("png"), "mask.png"),
    "image_size": Target(
        readers.size_of_image, lambda: [*seeds.pictures("png"), *seeds.pictures("jpg")], "a.img"
    ),
    "dtu_grid": dtu_target("ObsMask/ObsMask1_10.mat"),
    "dtu_plane": dtu_target("ObsMask/Plane1.mat"),
    "dtu_cloud": dtu_target("Points/stl/stl001_total.ply"),
    "vgg_npz": Target(readers.vgg, seeds.vgg_archives, "a.npz"),
    "gate": Target(readers.gate, seeds.gates, "gate"),
    "page": Target(readers.page, seeds.pages, "page.html"),
    "training": Target(readers.training, seeds.trainings, "training.npz"),
}
"""The targets of all readers by name: assets, checkpoints, meshes, cameras, images, TOML, results."""
if find_spec("msb.bench") is not None:  # msb.bench can be removed
    from fuzz import bench_targets

    TARGETS |= bench_targets.TARGETS
