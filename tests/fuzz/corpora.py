"""Write all bad assets, checkpoints, meshes and camera files: `python -m tests.fuzz.corpora OUTDIR`.

index.json has a row per file with four texts. These are the function of `fuzz.readers` that reads the file,
its path, the path below which the reader may open files, and the expected error code ("" if reading
succeeds).
"""

import json
import sys
from pathlib import Path

from tests.adapters import assemble, bad_checkpoints
from tests.corpus import bad_assets, good
from tests.meshes import bad_files, builders
from tests.scenes import bad_cameras
from tests.scenes.builders import write

Row = tuple[str, str, str, str]


def assets(root: Path) -> list[Row]:
    """Write all assets that are bad for every user, and a good asset. Return their rows."""
    root.mkdir()
    good.parts(good.mesh()).write_packed(root / "good")
    rows = [("asset", str(root / "good"), str(root / "good"), "")]
    for case in bad_assets.CASES:
        if not case.denied:
            path = str(bad_assets.write_case(case, root))
            raised = case.found_by == "load" and case.severity == "error"
            rows.append(("asset", path, path, case.code if raised else ""))
    return rows


def checkpoints(root: Path) -> list[Row]:
    """Write the bad checkpoints, and a good checkpoint. Return their rows."""
    root.mkdir()
    (root / "good").write_bytes(assemble.archive())
    rows = [("checkpoint", str(root / "good"), str(root / "good"), "")]
    for case in bad_checkpoints.CASES:
        path = str(bad_checkpoints.write_case(case, root))
        rows.append(("checkpoint", path, path, case.code))
    return rows


def meshes(root: Path) -> list[Row]:
    """Write all bad meshes, and a good mesh of each format. Return their rows."""
    root.mkdir()
    rows = []
    cases = [(suffix, content, "") for suffix, content in builders.SMALL.items()]
    cases.append((".obj", b"mtllib not-opened.mtl\nv 0 0 0\nusemtl a\n", ""))
    cases += [(suffix, content, code) for suffix, content, code in bad_files.BAD.values()]
    for number, (suffix, content, code) in enumerate(cases):
        path = root / f"{number}{suffix}"
        path.write_bytes(content)
        rows.append(("mesh", str(path), str(path), code))
    return rows


def cameras(root: Path) -> list[Row]:
    """Write all bad camera files with the files beside them, and good camera files. Return their rows."""
    cases = [(kind, files, "", "") for kind, files in bad_cameras.SMALL.items()]
    cases += [(name, files, target, code) for name, (files, target, code) in bad_cameras.BAD.items()]
    rows = []
    for number, (name, files, target, code) in enumerate(cases):
        folder = write(root / str(number), files)
        reader = "points" if name.startswith("points") else "cameras"
        rows.append((reader, str(folder / target), str(folder), code))
    return rows


def write_all(root: Path) -> int:
    """Write all files and index.json to the new folder `root`. Return the number of files."""
    root.mkdir(parents=True)
    rows = [row for make in (assets, checkpoints, meshes, cameras) for row in make(root / make.__name__)]
    (root / "index.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return len(rows)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m tests.fuzz.corpora OUTDIR")
    print(f"{write_all(Path(sys.argv[1]).absolute())} files in {sys.argv[1]}")
