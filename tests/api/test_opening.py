"""Open and save files: `msb.open`, `msb.load`, `msb.save`, and other functions with paths."""

import importlib
import inspect
import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import write_asset
from msb.errors import CheckpointError, InputError, MeshError, MsbError, OutputError, Unsupported, UsageError
from msb.meshes import read_mesh
from msb.meshes.formats import list_written_suffixes
from tests.cli.forks import run_msb
from tests.conftest import ROOT, of_the_whole

CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
DIFFSOUP = ROOT / "tests" / "tiny" / "models" / "walled" / "diffsoup"
NEAR = [[1.0, 0, 0], [1 + 1e-12, 0, 0], [1, 1, 0], [1, 0, 1]]
"""Two points that differ in float64 but not in float32."""
FACES = [[0, 1, 2], [0, 1, 3]]


@pytest.fixture
def mesh_file(tmp_path: Path) -> Path:
    path = tmp_path / "near.obj"
    rows = [f"v {x!r} {y} {z} 0.5 0.5 0.5" for x, y, z in NEAR]
    rows += ["f " + " ".join(str(corner + 1) for corner in face) for face in FACES]
    path.write_text("\n".join(rows) + "\n")
    return path


def audited(path: Path, *options: str) -> Any:
    done = run_msb(["audit", *options, "--json", "-", str(path)], ROOT, {})
    data = json.loads(done.stdout) if done.stdout else done.stderr.decode()
    return comparable(data) if isinstance(data, dict) else data


def comparable(audit: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in audit.items() if key not in ("timings_ms", "tool_version")}


@of_the_whole
def test_msb_lists_exactly_its_public_names() -> None:
    assert dir(msb) == sorted(msb.__all__)
    assert "open" in msb.__all__
    assert all(getattr(msb, name) is not None for name in msb.__all__)


def test_an_asset_a_checkpoint_and_a_mesh_file_are_opened(
    demo_asset: Path, mesh_file: Path, tmp_path: Path
) -> None:
    loaded = msb.load(demo_asset)
    write_asset(loaded, tmp_path / "folder", "folder")
    assert msb.open(demo_asset).manifest == msb.open(tmp_path / "folder").manifest == loaded.manifest
    assert msb.open(str(CHECKPOINT)).manifest == msb.export(CHECKPOINT).manifest
    model = next(CHECKPOINT.rglob("*.pt"))
    assert msb.open(model).manifest.method == "mesh_splatting"
    mesh = msb.open(mesh_file)
    assert (mesh.manifest.method, mesh.manifest.face_count) == ("mesh", 2)
    assert msb.open(mesh_file, method="mesh_splatting").manifest.method == "mesh_splatting"


def test_a_model_of_another_method_is_rejected(demo_asset: Path) -> None:
    for path in (demo_asset, CHECKPOINT):
        with pytest.raises(CheckpointError, match="CHECKPOINT_METHOD"):
            msb.open(path, method="two_dts")


@pytest.mark.parametrize("given", [3, None, b"a.triasset", ["a.triasset"], np.zeros(3)], ids=repr)
def test_values_that_are_not_paths_are_rejected(given: Any) -> None:
    for read in (msb.open, msb.load, msb.export):
        with pytest.raises(UsageError, match=r"^USAGE: "):
            read(given)
    with pytest.raises(MeshError, match=r"^MESH_ARRAY: "):
        msb.audit(given)


def test_load_suggests_open_for_other_files(mesh_file: Path, tmp_path: Path) -> None:
    for path in (mesh_file, CHECKPOINT, next(CHECKPOINT.rglob("*.pt")), tmp_path):
        with pytest.raises(InputError, match=r"FILE_NOT_RECOGNISED: .*msb"):
            msb.load(path)
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        msb.load(tmp_path / "absent.ply")
    (tmp_path / "bad.triasset").write_text("no ZIP")
    with pytest.raises(InputError, match="FILE_NOT_RECOGNISED"):
        msb.load(tmp_path / "bad.triasset")


@pytest.mark.slow
@pytest.mark.parametrize("weld", [(), ("--weld", "exact")], ids=["stored", "welded"])
def test_the_audit_of_a_path_is_that_of_the_command(
    demo_asset: Path, mesh_file: Path, weld: tuple[str, ...]
) -> None:
    for path in (demo_asset, CHECKPOINT, mesh_file):
        result = msb.audit(path, weld="exact" if weld else None).to_dict()
        assert comparable(result) == audited(path, *weld), path
    assert msb.audit(mesh_file).counts.zero_area_faces == 0
    assert msb.audit(msb.open(mesh_file)).counts.zero_area_faces == 2


@pytest.mark.parametrize("read", [msb.audit, msb.open, msb.load, msb.export, msb.repair, msb.validate])
def test_an_impossible_path_is_not_found(read: Callable[[str], Any]) -> None:
    with pytest.raises(InputError, match=r"FILE_NOT_FOUND: nul\\x00"):
        read("nul\0")


def test_a_mesh_with_nan_is_audited_but_not_opened(tmp_path: Path) -> None:
    points = np.array([[0, 0, np.nan], *NEAR[1:]])
    with (tmp_path / "nan.ply").open("wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty double x\n")
        file.write(b"property double y\nproperty double z\nelement face 1\n")
        file.write(b"property list uchar int vertex_indices\nend_header\n" + points.tobytes())
        file.write(b"\3" + np.arange(3, dtype="<i4").tobytes())
    assert msb.audit(tmp_path / "nan.ply").counts.nonfinite_faces == 1
    with pytest.raises(MsbError, match="TRIASSET_VALUE_NONFINITE"):
        msb.open(tmp_path / "nan.ply")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".triasset", *list_written_suffixes(), ".GLB"])
def test_an_asset_is_saved_in_the_format_of_its_suffix(demo_asset: Path, tmp_path: Path, suffix: str) -> None:
    asset, path = msb.load(demo_asset), tmp_path / f"a{suffix}"
    msb.save(asset, path)
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
        msb.save(asset, path)
    before = path.read_bytes()
    msb.save(asset, path, overwrite=True)
    assert path.read_bytes() == before
    assert msb.open(path).manifest.face_count == asset.manifest.face_count
    if suffix != ".triasset":
        other = tmp_path / f"b{suffix}"
        assert run_msb(["convert", "-q", str(demo_asset), str(other)], ROOT, {}).returncode == 0
        assert other.read_bytes() == before
        assert (read_mesh(path).vertex_colors is None) == (suffix == ".stl")


def test_a_folder_is_only_replaced_with_overwrite(demo_asset: Path, tmp_path: Path) -> None:
    asset, path = msb.load(demo_asset), tmp_path / "a.triasset"
    msb.save(asset, path, form="folder")
    assert path.is_dir()
    for form in ("packed", "folder"):
        with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
            msb.save(asset, path, form=form)
    msb.save(asset, path, form="folder", overwrite=True)
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
        msb.save(asset, path, overwrite=True)


@pytest.mark.parametrize(
    "changed",
    [
        {"asset": "a.triasset"},
        {"path": 3},
        {"path": "a.xyz"},
        {"path": "a"},
        {"form": "tar"},
        {"path": "a.glb", "form": "folder"},
    ],
    ids=repr,
)
def test_invalid_arguments_of_save_are_wrong_usage(
    changed: dict[str, Any], demo_asset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given: dict[str, Any] = {"asset": msb.load(demo_asset), "path": "a.triasset", **changed}
    with pytest.raises(UsageError, match=r"^USAGE: "):
        msb.save(**given)
    assert not list(tmp_path.iterdir())


def test_an_asset_without_static_colours_cannot_be_a_mesh_file(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match="UNSUPPORTED_TIER"):
        msb.save(msb.open(DIFFSOUP), tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_validate_agrees_with_the_command(tmp_path: Path, mesh_file: Path) -> None:
    broken = tmp_path / "broken.obj"
    broken.write_text(f"{mesh_file.read_text()}f 1 1 2\nf 9 1 2\n")
    degenerate = tmp_path / "degenerate.obj"
    degenerate.write_text(f"{mesh_file.read_text()}f 1 1 2\n")
    for path, valid, codes in (
        (CHECKPOINT, True, []),
        (degenerate, True, ["TRIASSET_FACE_REPEATED_INDEX", "TRIASSET_FACE_ZERO_AREA"]),
        (broken, False, ["MESH_INDEX_OUT_OF_RANGE"]),
    ):
        result = msb.validate(path)
        assert result.valid is valid
        assert [item.code for item in result.findings] == codes
        done = run_msb(["validate", str(path)], ROOT, {})
        assert done.stdout.decode().splitlines()[0] == result.title == str(result).splitlines()[0]
        assert all(code in str(result) for code in codes)
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        msb.validate(tmp_path / "nothing.ply")


@pytest.mark.parametrize(
    "name",
    [each for each in ("bake", "render", "repair", "score", "trial", "why") if find_spec(f"msb.{each}")],
)
def test_a_callable_package_is_called_like_its_function(name: str) -> None:
    package: Any = getattr(msb, name)
    assert callable(package)
    assert inspect.signature(package) == inspect.signature(getattr(package, name))
    assert package is importlib.import_module(f"msb.{name}")
