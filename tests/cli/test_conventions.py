"""Common properties of all commands: JSON, notes, logs and colours."""

import os
import re
from pathlib import Path

import pytest

from tests.cli.conftest import Msb, Refused, of_installed, on_terminal
from tests.conftest import ROOT

ASSET = "data_stubs/splat_like.triasset"
LINES = of_installed(
    f"audit {ASSET}",
    "audit --explain vf_ratio",
    f"bench --repeat 1 --seconds 0 --warmup 0 {ASSET}",
    "devices",
    "eval tests/golden/metrics/pred tests/golden/metrics/gt",
    "export data_stubs/checkpoint OUT/a.triasset",
    f"info {ASSET}",
    "methods",
    f"render --turntable 1 --size 32x24 -o OUT/images {ASSET}",
    f"repair {ASSET} OUT/repaired.triasset",
    "report --paper --table mesh_connectivity",
    "run --dry-run tests/tiny/protocol.toml",
    "scenes tests/tiny/scenes/dtu/scan1",
    f"validate {ASSET}",
    "validate --explain USAGE",
    "why --scale 0.1 --cameras data_stubs/views.json data_stubs/checkpoint",
)


@pytest.mark.slow
@pytest.mark.parametrize("line", LINES)
def test_a_document_has_its_schema_and_the_version(msb: Msb, tmp_path: Path, line: str) -> None:
    document = msb(f"{line} --json -".replace("OUT", str(tmp_path)), status=0).json
    assert re.fullmatch(r"msb\.[a-z]+/\d+", document["schema"])
    assert re.fullmatch(r"\d+\.\d+\.\d+", document["tool_version"])
    command, keys = line.split()[0], set(document) - {"schema", "tool_version", "machine"}
    if "--explain" not in line and (documented := _documented_keys().get(command)):
        assert keys == documented


def test_the_documentation_has_the_keys_of_these_commands() -> None:
    assert set(_documented_keys()) == {
        *("audit", "bench", "capture", "devices", "export", "info", "methods", "render", "repair", "scenes"),
        *("score", "validate", "why"),
    }


def _documented_keys() -> dict[str, set[str]]:
    """Return the keys of each command in the table of docs/cli.md."""
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    table = text.partition("| command | key | meaning |")[2].partition("\n\n")[0]
    keys: dict[str, set[str]] = {}
    command = ""
    for line in table.splitlines()[2:]:
        first, second = line.split("|")[1:3]
        command = first.strip(" `") or command
        keys.setdefault(command, set()).update(re.findall(r"`(\w+)`", second))
    return keys


@pytest.mark.slow
def test_steps_are_printed_with_vv_and_always_logged(msb: Msb, tmp_path: Path) -> None:
    log = tmp_path / "new" / "msb.log"
    assert msb("audit", "-q", "--log-file", log, ASSET).err == ""
    first = log.read_text(encoding="utf-8").splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d{4} (INFO|DEBUG) ", line) for line in first)
    assert f"-q --log-file {log} {ASSET}" in first[0]
    assert any(re.search(r"DEBUG reading .*: [\d.]+ ms$", line) for line in first)
    result = msb("audit", "--log-file", log, "missing.ply", status=3)
    lines = log.read_text(encoding="utf-8").splitlines()
    assert lines[: len(first)] == first
    assert " ERROR FILE_NOT_FOUND: missing.ply: " in lines[-1]
    assert "reading splat_like" not in msb("audit", "-v", ASSET).err
    assert "reading splat_like.triasset: " in msb("audit", "-vv", ASSET).err
    result = msb("info", "--log-file", tmp_path, ASSET)
    assert (result.status, result.err.split(":")[0]) == (3, "OUTPUT_UNWRITABLE")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "env", "colored"),
    [
        ((), {}, False),
        ((), {"FORCE_COLOR": "1"}, True),
        (("--color", "always"), {}, True),
        (("--color", "always"), {"NO_COLOR": "1"}, True),
        (("--color", "never"), {"FORCE_COLOR": "1"}, False),
        (("--color", "auto"), {"FORCE_COLOR": "1"}, False),
        ((), {"FORCE_COLOR": "1", "TERM": "dumb"}, False),
        ((), {"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
    ],
)
def test_colour_follows_options_and_variables(
    msb: Msb, args: tuple[str, ...], env: dict[str, str], colored: bool
) -> None:
    result = msb("validate", *args, ASSET, **{"TERM": "xterm-256color", **env})
    assert ("\x1b[" in result.out) is colored


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals are POSIX")
def test_json_on_a_terminal_has_no_escape_sequences() -> None:
    """On a terminal JSON is printed without progress and escape sequences."""
    outputs = {option: on_terminal("validate", *option.split(), ASSET) for option in ("--json -", "-q")}
    assert "\x1b" not in outputs["--json -"]
    assert outputs["--json -"].startswith("{")
    assert "\x1b[1mvalid\x1b[0m" in outputs["-q"]


@pytest.mark.parametrize("force", [(), ("--force",)])
@pytest.mark.parametrize(
    "text", [b"glTF\2\0\0\0", b"ply\nformat ascii 1.0\n", b"\n", b"2024-01-01 10:00 INFO a\n"]
)
def test_a_file_that_is_not_a_log_is_not_changed(
    tmp_path: Path, refused: Refused, text: bytes, force: tuple[str, ...]
) -> None:
    (tmp_path / "a.glb").write_bytes(text)
    (tmp_path / "link").symlink_to("a.glb")
    for name in ("a.glb", "link"):
        line = refused(["audit", *force, "--log-file", str(tmp_path / name), ASSET])
        assert line.startswith(f"OUTPUT_EXISTS: {tmp_path / name}: --log-file: ")
    assert (tmp_path / "a.glb").read_bytes() == text


@pytest.mark.slow
def test_a_log_is_created_or_extended(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "log").touch()
    for lines in (1, 2):
        msb("completion", "--log-file", tmp_path / "log", "bash", status=0)
        assert len((tmp_path / "log").read_text().splitlines()) == lines
    (tmp_path / "null").symlink_to(os.devnull)
    msb("completion", "--log-file", tmp_path / "null", "bash", status=0)


def test_the_log_does_not_create_a_missing_input(tmp_path: Path, refused: Refused) -> None:
    assert refused(f"audit --log-file {tmp_path}/a.ply {tmp_path}/a.ply").startswith("USAGE: ")
    assert list(tmp_path.iterdir()) == []
