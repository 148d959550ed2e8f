"""docs/triasset.md and docs/errors.md say what the code does."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from docs.make_errors import PAGE, page
from msb.asset import load, write_asset
from msb.asset.build import _ORDER
from msb.asset.check import _RESERVED, _STANDARD
from msb.asset.schema import manifest_schema
from msb.errors import CODES
from msb.methods import METHODS, PASSES
from tests.conftest import ROOT
from tests.corpus.good import decoder, mesh, soup

if TYPE_CHECKING:
    from pathlib import Path

DOC = (ROOT / "docs/triasset.md").read_text()
SCHEMA = manifest_schema()


def table(heading: str) -> dict[str, str]:
    """Return the rows of the first table below `heading`: first cell without backticks -> the rest."""
    lines = DOC[DOC.index(f"\n{heading}\n") :].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    rows = {}
    for line in lines[first + 1 :]:
        if not line.startswith("|"):
            break
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        rows[cells[0].strip("`")] = " | ".join(cells[1:])
    return rows


def code_block(language: str) -> str:
    match = re.search(rf"```{language}\n(.*?)```", DOC, re.DOTALL)
    assert match
    return match.group(1)


def words(text: str) -> set[str]:
    """Return everything the text has in backticks."""
    return set(re.findall(r"`([^`]+)`", text))


@pytest.mark.parametrize("make", [mesh, soup, decoder])
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
    shown = bytes.fromhex("".join(line.split("    ")[0] for line in code_block("hexdump").splitlines()))
    assert data[start : data.index(b"PK\x01\x02")] == shown


def test_the_table_of_keys_is_that_of_the_schema() -> None:
    rows = table("## The manifest")
    assert list(rows) == SCHEMA["required"]
    for key, row in rows.items():
        schema = SCHEMA["properties"][key]
        assert row.startswith(schema["type"])
        named = words(row)
        assert set(schema.get("enum", ())) <= named
        for inner, inner_schema in schema.get("properties", {}).items():
            assert inner in named
            assert set(inner_schema.get("enum", ())) <= named
    assert set(SCHEMA["properties"]["source"]["properties"]["files"]["items"]["properties"]) <= words(
        rows["source"]
    )


def test_the_tables_of_buffers_are_those_of_the_code() -> None:
    buffer = SCHEMA["properties"]["buffers"]["additionalProperties"]
    assert list(table("## Buffers")) == buffer["required"]
    assert set(buffer["properties"]["dtype"]["enum"]) <= words(table("## Buffers")["dtype"])
    assert set(buffer["properties"]["domain"]["enum"]) <= words(table("## Buffers")["domain"])
    start = DOC.index("| buffer | dtype |")
    rows = dict(
        re.findall(r"^\| `([a-z_.*]+)` \| (.*)$", DOC[start : DOC.index("**What our exporter")], re.MULTILINE)
    )
    assert list(rows) == [*_ORDER, "features.*", "decoder.*"]
    for name, (dtypes, _, domains) in _STANDARD.items():
        dtype, shape, domain, _ = rows[name].split(" | ", 3)
        assert dtype.split(" or ") == list(dtypes)
        assert tuple(domain.split(", ")) == domains
        assert shape


def test_settings_and_passes_are_those_of_the_methods() -> None:
    rows = table("### Settings")
    assert list(rows) == [name for name, method in METHODS.items() if method.settings] + ["others"]
    for name, row in rows.items():
        if name != "others":
            assert words(row) == set(METHODS[name].settings)
            choices = [choice for setting in METHODS[name].settings.values() for choice in setting.choices]
            assert re.findall(r'"([^"]+)"', row) == choices
    passes = table("### Passes")
    assert list(passes) == list(PASSES)
    assert all(row.rstrip(" |").startswith(PASSES[name]) for name, row in passes.items())


def test_device_names_are_those_that_are_refused() -> None:
    named = words(table("## Buffers")["file"])
    plain = {name for name in _RESERVED if not name[-1].isdigit()}
    assert plain | {"com0", "com9", "lpt0", "lpt9"} <= named
    assert plain | {f"{port}{i}" for port in ("com", "lpt") for i in range(10)} == _RESERVED


def test_the_page_of_codes_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m docs.make_errors"
    assert {name for name in words(page()) if name in CODES} == set(CODES)


def test_every_code_is_explained_in_whole_sentences() -> None:
    for name, code in CODES.items():
        for text in (code.summary, code.remedy):
            assert text.isprintable()
            assert text.endswith("."), name
            assert "|" not in text
