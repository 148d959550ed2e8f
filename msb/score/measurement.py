"""The score of an asset against a capture: pose, pictures, structure, evidence and hashes."""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from msb import metrics
from msb.api.auditing import audit_stored
from msb.api.opening import open as open_asset
from msb.api.opening import read_stored
from msb.asset import Asset
from msb.asset.strict_json import parse_strict_json
from msb.asset.tiers import refusal
from msb.base.extras import need_extra
from msb.base.files import file_sha256, regular_file
from msb.base.paths import given_path
from msb.errors import SceneError, Unsupported
from msb.meshes.assets import mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.metrics.images import PSNR_CAP
from msb.score.capture import Capture, Protocol
from msb.score.evidence import Evidence, Flag, gather_evidence, raise_flags
from msb.score.pictures import Picture, average_pictures, draw_pictures, move_asset
from msb.score.pose import Pose, PoseNotFoundError, find_pose
from msb.score.steadiness import Steadiness, measure_steadiness
from msb.topology.audit import Audit

SCHEMA = "msb.score/1"
# Largest size of a file of --pose in bytes, and largest deviation of its matrix from a similarity.
_MOST_BYTES, _TOLERANCE = 1 << 20, 1e-4


@dataclass(frozen=True)
class Structure:
    """The file of an asset: verdict and sentence of its audit, faces, bytes, and sizes of its textures.

    `texel_density` is the number of texels along a unit of length of the asset, on average over its area.
    """

    verdict: str
    sentence: str
    faces: int
    bytes: int
    textures: list[list[int]]
    texel_density: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON data."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class Score:
    """The score of one asset against one capture.

    Attributes
    ----------
    path, capture : str
    status : {"scored", "unverified"}
    why : str or None
        Why an asset is unverified.
    pose : Pose or None
    looks : dict or None
        Averages over the held-out views: "psnr" over all pixels, "psnr_covered", "psnr_mask" and
        "psnr_exposure" in dB, "ssim", "lpips". None without a pose.
    structure : Structure
    audit : Audit
    flags : list of Flag
        Reasons to distrust the numbers.
    evidence : Evidence or None
    covered_share : float or None
        Share of the pixels of all held-out views that the asset covers.
    pictures : list of Picture
        One for each held-out view; empty without a pose.
    steadiness : Steadiness or None
        Shimmer and popping on a walk, if one was requested.
    protocol : Protocol
    hashes : dict
        SHA-256 of the "asset", the "capture" and the "protocol".
    """

    path: str
    capture: str
    status: str
    why: str | None
    pose: Pose | None
    looks: dict[str, float | None] | None
    structure: Structure
    audit: Audit
    flags: list[Flag]
    evidence: Evidence | None
    covered_share: float | None
    mask_share: float | None
    test_views: int
    pictures: list[Picture]
    steadiness: Steadiness | None
    protocol: Protocol
    hashes: dict[str, str]
    seconds: float = field(default=0.0, compare=False)

    @property
    def verdict(self) -> str:
        """The verdict in a line: UNVERIFIED, the codes of flags, or the verdict of the audit."""
        if self.status == "unverified":
            return f"UNVERIFIED: {self.why}"
        if self.flags:
            named = "; ".join(f"{flag.code} ({flag.sentence})" for flag in self.flags)
            return f"DOUBTFUL: {named}"
        return f"{self.structure.verdict.upper()}: {self.structure.sentence}"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON document of `msb score`."""
        return {
            "schema": SCHEMA,
            "path": self.path,
            "capture": self.capture,
            "status": self.status,
            "why": self.why,
            "verdict": self.verdict,
            "pose": None if self.pose is None else self.pose.to_dict(),
            "views": {
                "test": self.test_views,
                "covered_share": self.covered_share,
                "mask_share": self.mask_share,
                "training": "unknown",
            },
            "looks": self.looks,
            "per_view": [
                {
                    "name": picture.view.camera.name,
                    "psnr": _finite(picture.psnr),
                    "psnr_covered": _finite(picture.psnr_covered),
                    "ssim": picture.ssim,
                    "lpips": picture.lpips,
                    "covered_share": float(picture.covered.mean()),
                }
                for picture in self.pictures
            ],
            "structure": self.structure.to_dict(),
            "flags": [vars(flag) for flag in self.flags],
            "evidence": None if self.evidence is None else self.evidence.to_dict(),
            "walk": None if self.steadiness is None else self.steadiness.to_dict(),
            "trial": None,
            "compared": None,
            "protocol": self.protocol.to_dict(),
            "hashes": self.hashes,
            "seconds": self.seconds,
        }


def _finite(value: float | None) -> float | None:
    """Return a PSNR as JSON stores it: equal images have 100 dB, as in averages."""
    return PSNR_CAP if value == math.inf else value


def score(
    path: str | os.PathLike[str],
    capture: str | os.PathLike[str] | Capture,
    *,
    pose: str | os.PathLike[str] = "found",
    protocol: Protocol | None = None,
    walk: int = 0,
    vgg_weights: Path | None = None,
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> Score:
    """Return how near an asset is to the photographs of a capture.

    Parameters
    ----------
    path : path-like
        An asset, checkpoint or mesh file.
    capture : path-like or Capture
        The folder of a scene, as `msb.read_scene` reads it. Pass a `Capture` to score several assets.
    pose : str or path-like
        "found": find it from the photographs. "capture": the asset is in the frame of the capture. Else a
        JSON file with a matrix (4, 4), ``capture = matrix @ asset``, or with a score.
    protocol : Protocol, optional
        Samples and background. Default: 16 samples over grey. A `Capture` has its own.
    walk : int
        Frames of a walk for shimmer and popping; 0 measures none.
    vgg_weights : Path, optional
        Weights for LPIPS.
    device : str, optional
        The OpenCL device.
    step : callable
        Called after each photograph or drawing.

    Raises
    ------
    UsageError, InputError, SceneError, AssetError, MeshFileError, CheckpointError, MetricError, Unsupported
        The asset, the capture or the file of the pose cannot be read. EXTRA_MISSING: OpenCV is missing.
    """
    start = time.perf_counter()
    need_extra("capture", "cv2", what="a score")
    place = given_path(path)
    reader = capture if isinstance(capture, Capture) else Capture(given_path(capture), protocol)
    asset = open_asset(place)
    if (reason := refusal(asset.manifest, "standard")) is not None:
        raise Unsupported("UNSUPPORTED_TIER", reason, file=place)
    stored = read_stored(place, images=True)
    audit, _ = audit_stored(stored)
    base = Score(
        path=str(path),
        capture=str(reader.path),
        status="unverified",
        why=None,
        pose=None,
        looks=None,
        structure=_describe_structure(place, asset, audit),
        audit=audit,
        flags=[],
        evidence=None,
        covered_share=None,
        mask_share=None,
        test_views=len(reader.scene.test),
        pictures=[],
        steadiness=None,
        protocol=reader.protocol,
        hashes={
            "asset": _hash_asset(place),
            "capture": reader.sha256,
            "protocol": reader.protocol.sha256,
        },
    )
    try:
        found = _choose_pose(pose, asset, reader, device, step)
    except PoseNotFoundError as error:
        return replace(base, why=str(error), seconds=time.perf_counter() - start)
    # Draw the asset in the frame of the capture, and look for what gives a trick away.
    moved = move_asset(asset, found)
    pictures = draw_pictures(moved, reader, metrics.Measures(vgg_weights), device, step)
    evidence = gather_evidence(moved, reader, found, pictures, device, step)
    covered = float(np.mean([picture.covered.mean() for picture in pictures]))
    masks = [share for picture in pictures if (share := picture.mask_share) is not None]
    mask = float(np.mean(masks)) if masks else None
    invalid = audit.counts.nonfinite_faces
    flags = raise_flags(evidence, found, moved, reader, covered, mask, invalid)
    return replace(
        base,
        status="scored",
        pose=found,
        looks=average_pictures(pictures),
        flags=flags,
        evidence=evidence,
        covered_share=covered,
        mask_share=mask,
        pictures=pictures,
        steadiness=measure_steadiness(moved, reader.scene, walk, device, step) if walk else None,
        seconds=time.perf_counter() - start,
    )


def _choose_pose(
    pose: str | os.PathLike[str], asset: Asset, capture: Capture, device: str | None, step: Callable[[], None]
) -> Pose:
    """Return the pose that the caller chose, or find it."""
    if pose == "capture":
        return Pose("capture", np.eye(4))
    if pose != "found":
        return Pose("file", read_matrix(given_path(pose)))
    return find_pose(mesh_from_asset(asset), capture.photographs(step), device, step)


def read_matrix(path: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the similarity (4, 4) in a JSON file: the matrix itself, or a "matrix" in it or in its "pose".

    Raises
    ------
    SceneError
        CAMERA_INVALID: there is no such matrix, or it is not a scale times a rotation or reflection.
    """
    data = regular_file(path).read_bytes()
    value = parse_strict_json(
        data, file=path, name="the file", max_bytes=_MOST_BYTES, error=SceneError, code="CAMERA_INVALID"
    )
    for key in ("pose", "matrix"):
        value = value.get(key, value) if isinstance(value, dict) else value
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    is_valid = matrix.shape == (4, 4) and np.isfinite(matrix).all() and (matrix[3] == (0, 0, 0, 1)).all()
    if is_valid:
        square = matrix[:3, :3] @ matrix[:3, :3].T
        scale = float(np.trace(square)) / 3
        is_valid = scale > 0 and bool(np.abs(square / scale - np.eye(3)).max() <= _TOLERANCE)
    if not is_valid:
        text = "it has no 4 x 4 matrix of a scale, a rotation and a translation, as the pose of a score is"
        raise SceneError("CAMERA_INVALID", text, file=path)
    return matrix


def _describe_structure(path: Path, asset: Asset, audit: Audit) -> Structure:
    images = [array for name, array in asset.buffers.items() if name.startswith("texture.")]
    textures = [[image.shape[1], image.shape[0]] for image in images]
    size = sum(file.stat().st_size for file in _list_files(path))
    density = _measure_texel_density(mesh_from_asset(asset)) if images else None
    return Structure(audit.verdict, audit.sentence, audit.counts.faces, size, textures, density)


def _measure_texel_density(mesh: Mesh) -> float | None:
    """Return the square root of texels per area; None for a mesh without area."""
    uvs = mesh.corner_uvs
    if uvs is None and mesh.vertex_uvs is not None:
        uvs = mesh.vertex_uvs[mesh.faces.reshape(-1)]
    if uvs is None:
        return None
    number = np.zeros(len(mesh.faces), int) if mesh.face_textures is None else mesh.face_textures
    sizes = np.array([image.shape[1::-1] for image in mesh.textures], np.float64)[number]
    # Twice the area of each face: in texels, and in units of the asset.
    a, b = (uvs.reshape(-1, 3, 2)[:, k].astype(np.float64) - uvs.reshape(-1, 3, 2)[:, 0] for k in (1, 2))
    texels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * sizes.prod(axis=1)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return math.sqrt(texels.sum() / area.sum()) if area.sum() > 0 else None


def _list_files(path: Path) -> list[Path]:
    """Return the files of an asset: one file, or all files of its folder."""
    return [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())


def _hash_asset(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and hashes of the files in a folder."""
    if path.is_file():
        return file_sha256(path)
    entries = [[file.relative_to(path).as_posix(), file_sha256(file)] for file in _list_files(path)]
    return hashlib.sha256(json.dumps(entries).encode()).hexdigest()
