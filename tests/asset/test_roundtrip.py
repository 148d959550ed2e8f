"""Assets survive saving and loading in both forms, and invalid assets are not written."""

import copy
import mmap
import pickle  # noqa: TID251 - the test pickles the data itself
import shutil
import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from msb.asset import Asset, build_asset, load, validate, write_asset
from msb.asset import writer as writer_module
from msb.errors import AssetError
from tests.corpus.good import Parts, decoder, mesh, parts, soup

MAKERS = [mesh, soup, decoder]
FORMS = ["packed", "folder"]


def assert_same(first: Asset, second: Asset) -> None:
    assert first.manifest == second.manifest
    assert list(first.buffers) == list(second.buffers)
    for name, array in first.buffers.items():
        assert array.dtype == second.buffers[name].dtype
        assert array.tobytes() == second.buffers[name].tobytes()
        assert array.shape == second.buffers[name].shape


def content(path: Path) -> dict[str, bytes]:
    """Return the bytes of a file, or of all files in a folder, by relative path."""
    if path.is_file():
        return {"": path.read_bytes()}
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def mapping_of(array: np.ndarray) -> Any:
    """Return the object that owns the memory of an array."""
    owner: Any = array
    while not isinstance(owner, mmap.mmap | bytes | None):
        owner = owner.obj if isinstance(owner, memoryview) else owner.base
    return owner


@pytest.mark.parametrize("make", MAKERS)
def test_the_same_content_gives_the_same_bytes(make, tmp_path: Path) -> None:
    for form in FORMS:
        write_asset(make(), tmp_path / f"{form}1", form)
        write_asset(load(tmp_path / f"{form}1"), tmp_path / f"{form}2", form)
        write_asset(make(), tmp_path / f"{form}3", form)
        assert (
            content(tmp_path / f"{form}1") == content(tmp_path / f"{form}2") == content(tmp_path / f"{form}3")
        )
    write_asset(load(tmp_path / "folder1"), tmp_path / "packed4")
    write_asset(load(tmp_path / "packed1"), tmp_path / "folder4", "folder")
    assert content(tmp_path / "packed4") == content(tmp_path / "packed1")
    assert content(tmp_path / "folder4") == content(tmp_path / "folder1")


@pytest.mark.parametrize("make", MAKERS)
def test_unpacking_the_file_gives_the_folder(make, tmp_path: Path) -> None:
    write_asset(make(), tmp_path / "packed")
    write_asset(make(), tmp_path / "folder", "folder")
    with zipfile.ZipFile(tmp_path / "packed") as archive:
        assert archive.testzip() is None
        assert archive.namelist()[0] == "manifest.json"
        archive.extractall(tmp_path / "unpacked")
    assert content(tmp_path / "unpacked") == content(tmp_path / "folder")


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda a: pickle.loads(pickle.dumps(a))])
@pytest.mark.parametrize("make", MAKERS)
def test_a_copy_of_an_asset_is_the_asset(make, duplicate, tmp_path: Path) -> None:
    write_asset(make(), tmp_path / "a")
    for asset in (make(), load(tmp_path / "a")):
        second = duplicate(asset)
        assert_same(asset, second)
        assert (second.path, second.warnings) == (asset.path, asset.warnings)
        with pytest.raises(TypeError):
            second.buffers["positions"] = second.buffers["positions"]
        shared = duplicate is copy.copy
        for name, array in second.buffers.items():
            assert not array.flags.writeable
            assert np.shares_memory(array, asset.buffers[name]) == (shared and array.size > 0)
        write_asset(second, tmp_path / "b")
        assert content(tmp_path / "b") == content(tmp_path / "a")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("make", MAKERS)
def test_arrays_are_read_only_views_of_the_mapped_file(make, form, tmp_path: Path) -> None:
    write_asset(make(), tmp_path / "a", form)
    asset = load(tmp_path / "a")
    mappings = set()
    for array in asset.buffers.values():
        mapping = mapping_of(array)
        assert isinstance(mapping, mmap.mmap)
        assert np.shares_memory(array, np.frombuffer(mapping, np.uint8))
        assert array.ctypes.data % 64 == 0
        mappings.add(id(mapping))
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True
    assert len(mappings) == (1 if form == "packed" else len(asset.buffers))


@pytest.mark.parametrize("form", FORMS)
def test_a_loaded_asset_outlives_its_file(form, tmp_path: Path) -> None:
    """If the file is replaced, a loaded asset keeps its values, because the old file stays mapped."""
    write_asset(mesh(), tmp_path / "a", form)
    asset = load(tmp_path / "a")
    write_asset(soup(), tmp_path / "a", form)
    assert_same(asset, mesh())
    assert_same(load(tmp_path / "a"), soup())
    if form == "folder":
        shutil.rmtree(tmp_path / "a")
    else:
        (tmp_path / "a").unlink()
    assert_same(asset, mesh())


def one_file(order: list[str]) -> Parts:
    """Return the parts of a triangle soup with all buffers in a single file, in the given order."""
    good = parts(soup())
    data = b""
    for name in order:
        spec = good.manifest["buffers"][name]
        data += bytes(-len(data) % 64)
        whole = good.files.pop(spec["file"])
        spec.update(file="buffers/all.bin", offset=len(data))
        data += whole
    good.files["buffers/all.bin"] = data
    return good


@pytest.mark.parametrize("order", [sorted(soup().buffers), sorted(soup().buffers, reverse=True)])
def test_buffers_may_share_a_file(order: list[str], tmp_path: Path) -> None:
    shared = one_file(order)
    shared.write_packed(tmp_path / "packed")
    shared.write_folder(tmp_path / "folder")
    for form in FORMS:
        asset = load(tmp_path / form)
        assert validate(tmp_path / form).findings == ()
        for name, array in soup().buffers.items():
            assert asset.buffers[name].tobytes() == array.tobytes()
        write_asset(asset, tmp_path / f"{form} again", form)
        assert content(tmp_path / f"{form} again")[("", "buffers/all.bin")[form == "folder"]]
        assert_same(load(tmp_path / f"{form} again"), asset)


@pytest.mark.parametrize("form", FORMS)
def test_a_link_given_by_the_user_is_followed(form, tmp_path: Path) -> None:
    """Only links inside of an asset are rejected."""
    write_asset(mesh(), tmp_path / "a", form)
    (tmp_path / "link").symlink_to("a")
    assert_same(load(tmp_path / "link"), mesh())


@settings(max_examples=40)
@given(st.data())
def test_any_arrays_survive_both_forms(tmp_path_factory, data) -> None:
    vertices, faces = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 9))
    finite = st.floats(-1e6, 1e6, width=32)
    any_float = st.floats(width=32, allow_nan=False)
    buffers = {
        "positions": data.draw(arrays(np.float32, (vertices, 3), elements=finite)),
        "indices": data.draw(arrays(np.uint32, (faces, 3), elements=st.integers(0, vertices - 1))),
        "opacity": data.draw(arrays(np.float32, faces, elements=any_float)),
        "color": data.draw(arrays(np.uint8, (3 * faces, 4))),
        "features.x": data.draw(arrays(np.float32, st.tuples(*[st.integers(1, 3)] * 3), elements=finite)),
    }
    copies = {name: array.copy() for name, array in buffers.items()}
    domains: Any = {"opacity": "face", "color": "corner", "features.x": "global"}
    asset = build_asset(buffers, domains)
    folder = tmp_path_factory.mktemp("any")
    for form in FORMS:
        write_asset(asset, folder / form, form)
        loaded = load(folder / form)
        assert_same(asset, loaded)
        assert validate(folder / form).valid
    for name, array in buffers.items():
        assert array.tobytes() == copies[name].tobytes()


def test_large_members_are_written_with_zip64_records(tmp_path: Path, monkeypatch) -> None:
    """The test replaces the limit of 1 GiB by 1 byte."""
    monkeypatch.setattr(writer_module, "_ZIP64_FROM", 1)
    write_asset(soup(), tmp_path / "a")
    data = (tmp_path / "a").read_bytes()
    assert struct.unpack_from("<2I2H", data, 18) == (0xFFFFFFFF, 0xFFFFFFFF, 13, 65 + 20)
    assert struct.unpack_from("<2H2Q", data, 43 + 65) == (1, 16, *[len(soup().manifest.to_bytes())] * 2)
    assert validate(tmp_path / "a").findings == ()
    with zipfile.ZipFile(tmp_path / "a") as archive:
        assert archive.testzip() is None
    loaded = load(tmp_path / "a")
    assert loaded.manifest == soup().manifest
    assert all(array.ctypes.data % 64 == 0 for array in loaded.buffers.values())
    write_asset(loaded, tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == data


# --- invalid assets are not written --------------------------------------------------------------------


def refused(asset: Asset, tmp_path: Path) -> str:
    """Return the code of the error that both forms raise for `asset`."""
    codes = set()
    for form in FORMS:
        with pytest.raises(AssetError) as caught:
            write_asset(asset, tmp_path / "new/a", form)
        codes.add(caught.value.code.removeprefix("TRIASSET_"))
    assert not list(tmp_path.iterdir())
    (code,) = codes
    return code


@pytest.mark.slow
def test_an_invalid_manifest_is_not_written(tmp_path: Path) -> None:
    good = mesh()
    spec = good.manifest.buffers["color"]
    escaped = {**good.manifest.buffers, "color": replace(spec, file="../../escaped.bin")}
    assert refused(Asset(replace(good.manifest, buffers=escaped), good.buffers), tmp_path) == "PATH"
    assert refused(Asset(replace(good.manifest, vertex_count=5), good.buffers), tmp_path) == "BUFFER"
    nan = {"kernel": "solid", "gamma": float("nan")}
    assert refused(Asset(replace(good.manifest, coverage=nan), good.buffers), tmp_path) == "FIELD"
    wide = replace(good.manifest, extra={"x": [0] * 200_000})
    assert refused(Asset(wide, good.buffers), tmp_path) == "MANIFEST"


def test_invalid_buffers_are_not_written(tmp_path: Path) -> None:
    good = mesh()
    color = good.buffers["color"]
    for buffers in (
        {**good.buffers, "color": color[:3]},
        {**good.buffers, "color": color.astype("float32")},
        {**good.buffers, "color": color.reshape(3, 4)},
        {name: array for name, array in good.buffers.items() if name != "color"},
    ):
        assert refused(Asset(good.manifest, MappingProxyType(buffers)), tmp_path) == "BUFFER"
