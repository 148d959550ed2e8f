"""An asset is written whole or not at all, and never one that cannot be read again."""

from __future__ import annotations

import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from msb.asset import Asset, load, validate, write_asset
from msb.asset import writer as writer_module
from msb.errors import AssetError
from tests.corpus.good import mesh, soup

FORMS = ["packed", "folder"]


# --- ZIP64 ---------------------------------------------------------------------------------------------


def test_large_members_are_written_with_zip64_records(tmp_path: Path, monkeypatch) -> None:
    """As they are from 1 GiB on; here from 1 byte on."""
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


# --- whole or not at all; more of it is in tests/base/test_atomic.py -----------------------------------


# --- nothing that cannot be read again -----------------------------------------------------------------


def refused(asset: Asset, tmp_path: Path) -> str:
    """Return the code with which both forms refuse to write `asset`."""
    codes = set()
    for form in FORMS:
        with pytest.raises(AssetError) as caught:
            write_asset(asset, tmp_path / "new/a", form)
        codes.add(caught.value.code.removeprefix("TRIASSET_"))
    assert not list(tmp_path.iterdir())
    (code,) = codes
    return code


@pytest.mark.slow
def test_a_manifest_changed_by_hand_is_checked(tmp_path: Path) -> None:
    good = mesh()
    spec = good.manifest.buffers["color"]
    escaped = {**good.manifest.buffers, "color": replace(spec, file="../../escaped.bin")}
    assert refused(Asset(replace(good.manifest, buffers=escaped), good.buffers), tmp_path) == "PATH"
    assert refused(Asset(replace(good.manifest, vertex_count=5), good.buffers), tmp_path) == "BUFFER"
    nan = {"kernel": "solid", "gamma": float("nan")}
    assert refused(Asset(replace(good.manifest, coverage=nan), good.buffers), tmp_path) == "FIELD"
    wide = replace(good.manifest, extra={"x": [0] * 200_000})
    assert refused(Asset(wide, good.buffers), tmp_path) == "MANIFEST"


def test_buffers_changed_by_hand_are_checked(tmp_path: Path) -> None:
    good = mesh()
    color = good.buffers["color"]
    for buffers in (
        {**good.buffers, "color": color[:3]},
        {**good.buffers, "color": color.astype("float32")},
        {**good.buffers, "color": color.reshape(3, 4)},
        {name: array for name, array in good.buffers.items() if name != "color"},
    ):
        assert refused(Asset(good.manifest, MappingProxyType(buffers)), tmp_path) == "BUFFER"
