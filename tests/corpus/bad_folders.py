"""Bad assets with paths outside of the asset, links or devices instead of files, or bad buffer contents."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from msb.asset import Asset
from tests.corpus.bad_zips import good_entries
from tests.corpus.case import Case, Writer, manifest_case, packed_case
from tests.corpus.forge import forge
from tests.corpus.good import Parts, decoder, mesh, parts, soup

_POSITIONS, _COLOR = "buffers/positions.bin", "buffers/color.bin"

# --- names and files ---------------------------------------------------------------------------------------

_NAMES = {
    "parent": "../positions.bin",
    "dots": "buffers/a..b.bin",
    "absolute": "/etc/passwd",
    "nul": "buffers/a\0.bin",
    "line_break": "buffers/positions.bin\n",
    "device": "buffers/NUL.tar.bin",
    "empty": "",
    "very_long": f"buffers/{'x' * 500_000}.bin",
}


def _on_disk(name: str, code: str, spoil: Writer, **more: Any) -> Case:
    """Return a case that consists of a good folder, changed by `spoil`."""

    def write(path: Path) -> None:
        parts(mesh()).write_folder(path)
        parts(mesh()).write_folder(path.with_name("outside"))
        spoil(path)

    return Case(name, f"TRIASSET_{code}", write, **more)


def _replaced(member: str, make: Writer) -> Writer:
    """Return a function that replaces a member of the asset by the result of `make`."""

    def spoil(path: Path) -> None:
        place = path / member
        shutil.rmtree(place) if place.is_dir() else place.unlink()
        make(place)

    return spoil


def _link(member: str, target: str) -> Writer:
    return _replaced(member, lambda place: place.symlink_to(target))


def _case_twins(path: Path) -> None:
    good = parts(mesh()).change("/buffers/color/file", "buffers/POSITIONS.bin")
    good.files["buffers/POSITIONS.bin"] = good.files.pop(_COLOR)
    good.write_folder(path)


def _denied(name: str, mode: int = 0) -> Writer:
    return lambda path: (path / name).chmod(mode)


def _denied_file(path: Path) -> None:
    path.write_bytes(forge(good_entries()))
    path.chmod(0)


PATH_CASES = [
    *(
        manifest_case(f"path_{name}", "PATH", {"/buffers/positions/file": file})
        for name, file in _NAMES.items()
    ),
    Case("path_case_twins", "TRIASSET_PATH", _case_twins),
    _on_disk("link_out", "PATH", _link(_POSITIONS, "../../outside/buffers/positions.bin")),
    _on_disk("link_buffers", "PATH", _link("buffers", "../outside/buffers")),
    _on_disk("link_manifest", "PATH", _link("manifest.json", "../outside/manifest.json")),
    _on_disk("folder_for_buffer", "PATH", _replaced(_POSITIONS, os.mkdir)),
    _on_disk("folder_for_manifest", "PATH", _replaced("manifest.json", os.mkdir)),
    _on_disk("pipe_for_buffer", "PATH", _replaced(_POSITIONS, os.mkfifo)),
    _on_disk("file_for_buffers", "DAMAGED", _replaced("buffers", lambda place: place.write_bytes(b""))),
    _on_disk(
        "hardlink",
        "PATH",
        lambda path: os.link(path / _COLOR, path.with_name("second")),
        severity="warning",
        found_by="validate",
    ),
    *(
        _on_disk(
            f"stray_{i}",
            "FILE_UNDECLARED",
            lambda path, name=name: (path / name).write_bytes(b"stray"),
            severity="warning",
        )
        for i, name in enumerate(["notes.txt", "buffers/x.bin", "\x1b[2J\n"])
    ),
    *(
        _on_disk(f"denied_{i}", "FILE_UNREADABLE", _denied(name), denied=True)
        for i, name in enumerate([_POSITIONS, "manifest.json", ".", "buffers"])
    ),
    _on_disk("denied_listing", "FILE_UNREADABLE", _denied(".", 0o311), severity="warning", denied=True),
    Case("not_there", "FILE_NOT_FOUND", lambda path: None),
    Case("not_there_loop", "FILE_UNREADABLE", lambda path: path.symlink_to(path.name)),
    Case("not_file_pipe", "FILE_UNREADABLE", os.mkfifo),
    Case("denied_file", "FILE_UNREADABLE", _denied_file, denied=True),
]

# --- contents ----------------------------------------------------------------------------------------------


def _file(name: str, code: str, spoil: Callable[[dict[str, bytes]], object]) -> list[Case]:
    """Return two cases, a folder and a packed asset, whose files are changed by `spoil`."""

    def make() -> Parts:
        good = parts(mesh())
        spoil(good.files)
        return good

    in_folder = Case(f"{name}_folder", f"TRIASSET_{code}", lambda path: make().write_folder(path))
    return [in_folder, packed_case(f"{name}_packed", code, make)]


FILE_CASES = [
    *_file("buffer_missing", "DAMAGED", lambda files: files.pop(_COLOR)),
    *_file("truncated", "DAMAGED", lambda files: files.update({_COLOR: files[_COLOR][:-1]})),
    *_file("longer", "DAMAGED", lambda files: files.update({_COLOR: files[_COLOR] + b"\0"})),
    _file("buffer_undeclared", "FILE_UNDECLARED", lambda files: files.update({"buffers/x.bin": b"x"}))[1],
]


def _values(
    name: str, code: str, buffer: str, put: dict[Any, Any], make: Callable[[], Asset] = mesh, **more: Any
) -> Case:
    """Return a case in which some elements of a buffer have new values (`put`). The hash matches them."""

    def change() -> Parts:
        asset = make()
        array = asset.buffers[buffer].copy()
        for where, value in put.items():
            array[where] = value
        return parts(asset).set_array(buffer, array)

    return packed_case(name, code, change, **{"found_by": "validate", **more})


def _stated(name: str, code: str, pointer: str, value: Any, **more: Any) -> Case:
    return manifest_case(name, code, {pointer: value}, found_by="validate", **more)


def _signalling_nan() -> Parts:
    good = parts(mesh())
    array = np.frombuffer(good.files[_POSITIONS], np.uint32).reshape(4, 3).copy()
    array[2, 1] = 0x7FA00001
    return good.set_array("positions", array.view(np.float32))


def _float_color() -> Parts:
    good = parts(mesh()).change("/buffers/color/dtype", "float32")
    return good.set_array("color", np.full((4, 3), 1.5, np.float32))


def _placed(points: Any, most: list[float], radius: float) -> Parts:
    """Return a mesh of other points. Its bounds and bounding sphere match the points."""
    good = parts(mesh()).set_array("positions", np.array(points, np.float32))
    good.change("/bounds", {"min": [0, 0, 0], "max": most})
    return good.change("/bounding_sphere", {"center": [0, 0, 0], "radius": radius})


NAN, INF = float("nan"), float("inf")
_NOTED = {"severity": "info", "found_by": "command"}
_WARNED = {"severity": "warning", "found_by": "validate"}
VALUE_CASES = [
    packed_case("signalling_nan", "VALUE_NONFINITE", _signalling_nan, found_by="validate"),
    _values("nan_opacity", "VALUE_NONFINITE", "opacity", {0: NAN}, soup),
    _values("inf_weight", "VALUE_NONFINITE", "decoder.w0", {(0, 0): INF}, decoder),
    _values("index_greatest", "INDEX_OUT_OF_RANGE", "indices", {(0, 0): 2**32 - 1}),
    _values("soup_swapped", "VALUE_RANGE", "indices", {...: [[3, 4, 5], [0, 1, 2]]}, soup),
    packed_case("color_range", "VALUE_RANGE", _float_color, **_WARNED),
    packed_case(
        "magnitude",
        "VALUE_RANGE",
        lambda: _placed(3e38 * np.eye(4, 3, k=-1), [3e38] * 3, 3.003e38),
        **_WARNED,
    ),
    _stated("bounds_small", "BOUNDS", "/bounds/max/2", 2.5),
    _stated("sphere_small", "BOUNDS", "/bounding_sphere/radius", 1),
    _stated("sphere_loose", "BOUNDS", "/bounding_sphere/radius", 300, severity="warning"),
    _stated("checksum", "DAMAGED", "/buffers/color/sha256", "0123456789abcdef" * 4),
    _values("face_repeated_index", "FACE_REPEATED_INDEX", "indices", {(2, 1): 0}, **_NOTED),
    _values("face_duplicate", "FACE_DUPLICATE", "indices", {2: [1, 3, 0]}, **_NOTED),
    _values(
        "vertex_unreferenced",
        "VERTEX_UNREFERENCED",
        "indices",
        {...: [[0, 1, 2], [2, 1, 0], [1, 2, 0], [1, 0, 2]]},
        **_NOTED,
    ),
    packed_case(
        "face_zero_area",
        "FACE_ZERO_AREA",
        lambda: _placed([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 3]], [2, 0, 3], 4),
        **_NOTED,
    ),
]

CASES = [*PATH_CASES, *FILE_CASES, *VALUE_CASES]
