"""The example reader and the hexdump in docs/triasset.md are correct."""

import re
from pathlib import Path

import pytest

from msb.asset import load, write_asset
from tests.conftest import ROOT
from tests.corpus.good import decoder, mesh, soup, textured

DOC = (ROOT / "docs/triasset.md").read_text()


def code_block(language: str) -> str:
    match = re.search(rf"```{language}\n(.*?)```", DOC, re.DOTALL)
    assert match
    return match.group(1)


@pytest.mark.parametrize("make", [mesh, soup, decoder, textured])
def test_the_minimal_reader_reads_what_we_write(make, tmp_path: Path) -> None:
    write_asset(make(), tmp_path / "a.triasset")
    code = code_block("python")
    assert "zipfile" not in code
    assert len(code.splitlines()) <= 27
    names: dict = {}
    exec(compile(code, "docs/triasset.md", "exec"), names)
    manifest, arrays = names["read"](tmp_path / "a.triasset")
    asset = load(tmp_path / "a.triasset")
    assert manifest == asset.manifest.to_dict() | {"buffers": manifest["buffers"]}
    assert list(arrays) == list(asset.buffers)
    for name, array in asset.buffers.items():
        assert arrays[name].dtype == array.dtype
        assert arrays[name].tobytes() == array.tobytes()
        assert arrays[name].shape == array.shape


def test_the_hexdump_is_what_the_writer_writes(tmp_path: Path) -> None:
    write_asset(mesh(), tmp_path / "a")
    data = (tmp_path / "a").read_bytes()
    start = data.rindex(b"PK\x03\x04")
    assert start % 64 == 48
    expected = bytes.fromhex("".join(line.split("    ")[0] for line in code_block("text").splitlines()))
    assert data[start : data.index(b"PK\x01\x02")] == expected
