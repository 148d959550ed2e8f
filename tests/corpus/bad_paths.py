"""Names that lead out of the asset, and files that are not what they seem (class 20)."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

from tests.corpus.case import Case, packed
from tests.corpus.good import mesh, parts

_NAMES = [
    ("parent", "../positions.bin"),
    ("parent_below", "buffers/../../positions.bin"),
    ("parent_inside", "buffers/../manifest.json"),
    ("parent_encoded", "buffers/%2e%2e/positions.bin"),
    ("dots", "buffers/a..b.bin"),
    ("absolute", "/etc/passwd"),
    ("absolute_bin", "/buffers/positions.bin"),
    ("drive", "C:\\positions.bin"),
    ("drive_relative", "C:positions.bin"),
    ("backslash", "buffers\\positions.bin"),
    ("host", "//host/share/positions.bin"),
    ("unc", "\\\\host\\share\\positions.bin"),
    ("url", "file:///etc/passwd"),
    ("home", "~/positions.bin"),
    ("variable", "buffers/$HOME.bin"),
    ("nul", "buffers/a\0.bin"),
    ("line_break", "buffers/positions.bin\n"),
    ("space", "buffers/positions.bin "),
    ("stream", "buffers/positions.bin:hidden.bin"),
    ("wide_slash", "buffers\uff0fpositions.bin"),
    ("wide_dots", "buffers/\uff0e\uff0e.bin"),
    ("cyrillic", "buffers/p\u043esitions.bin"),
    ("right_to_left", "buffers/\u202enib.bin"),
    ("device_con", "buffers/con.bin"),
    ("device_nul", "buffers/NUL.tar.bin"),
    ("device_com1", "buffers/COM1.bin"),
    ("device_lpt9", "buffers/Lpt9.x.bin"),
    ("hidden", "buffers/.positions.bin"),
    ("option", "buffers/-rf.bin"),
    ("nested", "buffers/a/b.bin"),
    ("no_folder", "positions.bin"),
    ("other_folder", "buffer/positions.bin"),
    ("folder_capitals", "Buffers/positions.bin"),
    ("extension", "buffers/positions.BIN"),
    ("no_extension", "buffers/positions"),
    ("no_name", "buffers/.bin"),
    ("folder_only", "buffers/"),
    ("dot", "."),
    ("empty", ""),
    ("manifest", "manifest.json"),
    ("long", f"buffers/{'x' * 101}.bin"),
    ("very_long", f"buffers/{'x' * 500_000}.bin"),
]


def _named(name: str, file: str) -> Case:
    make = packed(lambda: parts(mesh()).change("/buffers/positions/file", file))
    return Case(f"path_{name}", "TRIASSET_PATH", make)


def _on_disk(name: str, code: str, spoil: Callable[[Path], None], **more: object) -> Case:
    """Return a case that is a good folder after `spoil` has been at it."""

    def write(path: Path) -> None:
        parts(mesh()).write_folder(path)
        spoil(path)

    return Case(name, code, write, **more)


def _outside(path: Path) -> Path:
    """Return a folder beside the asset that holds copies of its files."""
    outside = path.with_name("outside")
    parts(mesh()).write_folder(outside)
    return outside


def _link_to(member: str, target: str) -> Callable[[Path], None]:
    """Return a function that replaces `member` by a link; {outside} stands for a folder beside the asset."""

    def spoil(path: Path) -> None:
        _outside(path)
        _remove(path / member)
        (path / member).symlink_to(target.format(outside=path.with_name("outside")))

    return spoil


def _remove(path: Path) -> None:
    if path.is_dir():
        for child in path.iterdir():
            child.unlink()
        path.rmdir()
    else:
        path.unlink()


def _replaced(member: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        _remove(path / member)
        make(path / member)

    return spoil


def _socket(path: Path) -> None:
    """Bind a socket at `path`; bound by its bare name, since such names have at most 107 bytes."""
    before = os.open(".", os.O_RDONLY)
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.fchdir(before)
        os.close(before)


def _hardlink(path: Path) -> None:
    os.link(path / "buffers/color.bin", path.with_name("second_name"))


def _hardlink_in(path: Path) -> None:
    (path / "buffers/color.bin").unlink()
    os.link(_outside(path) / "buffers/color.bin", path / "buffers/color.bin")


def _case_twins(path: Path) -> None:
    good = parts(mesh()).change("/buffers/color/file", "buffers/POSITIONS.bin")
    good.files["buffers/POSITIONS.bin"] = good.files.pop("buffers/color.bin")
    good.write_folder(path)


def _stray(name: str) -> Callable[[Path], None]:
    return lambda path: (path / name).write_bytes(b"stray") and None


def _denied(name: str) -> Callable[[Path], None]:
    return lambda path: (path / name).chmod(0)


PATH = "TRIASSET_PATH"
BUFFER = "buffers/positions.bin"

CASES = [
    *(_named(name, file) for name, file in _NAMES),
    Case("path_case_twins", "TRIASSET_PATH", _case_twins),
    _on_disk("link_out", PATH, _link_to(BUFFER, "{outside}/buffers/positions.bin")),
    _on_disk("link_passwd", PATH, _link_to(BUFFER, "/etc/passwd")),
    _on_disk("link_relative", PATH, _link_to(BUFFER, "../../outside/buffers/positions.bin")),
    _on_disk("link_inside", PATH, _link_to(BUFFER, "color.bin")),
    _on_disk("link_dangling", PATH, _link_to(BUFFER, "nothing")),
    _on_disk("link_loop", PATH, _link_to(BUFFER, "positions.bin")),
    _on_disk("link_proc", PATH, _link_to(BUFFER, "/proc/self/mem")),
    _on_disk("link_buffers", PATH, _link_to("buffers", "{outside}/buffers")),
    _on_disk("link_buffers_up", PATH, _link_to("buffers", ".")),
    _on_disk("link_manifest", PATH, _link_to("manifest.json", "{outside}/manifest.json")),
    _on_disk("link_manifest_loop", PATH, _link_to("manifest.json", "manifest.json")),
    _on_disk("folder_for_buffer", PATH, _replaced(BUFFER, os.mkdir)),
    _on_disk("folder_for_manifest", PATH, _replaced("manifest.json", os.mkdir)),
    _on_disk("pipe_for_buffer", PATH, _replaced(BUFFER, os.mkfifo)),
    _on_disk("pipe_for_manifest", PATH, _replaced("manifest.json", os.mkfifo)),
    _on_disk("socket_for_buffer", PATH, _replaced(BUFFER, _socket)),
    _on_disk(
        "file_for_buffers",
        "TRIASSET_DAMAGED",
        _replaced("buffers", lambda path: path.write_bytes(b"")),
    ),
    _on_disk("hardlink", "TRIASSET_PATH", _hardlink, severity="warning", found_by="validate"),
    _on_disk("hardlink_in", "TRIASSET_PATH", _hardlink_in, severity="warning", found_by="validate"),
    _on_disk("stray_file", "TRIASSET_FILE_UNDECLARED", _stray("notes.txt"), severity="warning"),
    _on_disk("stray_buffer", "TRIASSET_FILE_UNDECLARED", _stray("buffers/x.bin"), severity="warning"),
    _on_disk("stray_unprintable", "TRIASSET_FILE_UNDECLARED", _stray("\x1b[2J\n"), severity="warning"),
    _on_disk("denied_buffer", "TRIASSET_FILE_UNREADABLE", _denied(BUFFER), denied=True),
    _on_disk("denied_manifest", "TRIASSET_FILE_UNREADABLE", _denied("manifest.json"), denied=True),
    _on_disk("denied_folder", "TRIASSET_FILE_UNREADABLE", _denied("."), denied=True),
    _on_disk("denied_buffers", "TRIASSET_FILE_UNREADABLE", _denied("buffers"), denied=True),
    _on_disk(
        "denied_listing",
        "TRIASSET_FILE_UNREADABLE",
        lambda path: path.chmod(0o311),
        severity="warning",
        denied=True,
    ),
]
