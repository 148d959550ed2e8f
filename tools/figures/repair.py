"""Measure trials and repairs of single meshes, and create the images of docs/trial.md and docs/repair.md.

    python -m tools.figures.repair                      all models of data_stubs, and a torus
    python -m tools.figures.repair splat_like torus     these only
    python -m tools.figures.repair vase=mesh.ply        your mesh, with a title of `TITLES`

The figures are stored in benchmarks/results/repair-figures.json. `python -m benchmarks.pages` prints them.
Figures of other meshes are kept. `PICTURED` selects the meshes of the images.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import msb
from benchmarks.repair_figures import TITLES
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.repair.plan import Options
from msb.trial.repairs import compare
from msb.trial.run import try_asset
from msb.views import choose_views

ROOT = Path(__file__).parents[2]
STUBS = ROOT / "data_stubs"
FIGURES, IMAGES = ROOT / "benchmarks" / "results" / "repair-figures.json", ROOT / "docs" / "images"
COMPARED = ("torus", "walled_mesh_splatting", "splat_like", "vase")
"""Meshes whose repairs are compared."""
PICTURED = {
    "torus": ("uv", "decimate_25", "collision", "solid"),
    "splat_like": ("uv", "decimate_25", "subdivide", "solid"),
}
"""The tasks that docs/images/trial.png shows in the row of each mesh."""
SHOWN = ("orient-pair", "cut-by-igl", "drop-orient", "orient-pair-close")
"""The strategies in docs/images/repair.png."""
TILE = (300, 225)


def paths() -> dict[str, Path]:
    """Return the paths of the stored meshes."""
    models = {f"{path.parent.name}_{path.name}": path for path in (STUBS / "models").glob("*/*")}
    known = {name: path for name, path in models.items() if name in TITLES}
    return {**known, "splat_like": STUBS / "splat_like.triasset"}


def torus(around_it: int = 48, through: int = 24) -> msb.Asset:
    """Return a closed mesh of 2,304 faces, coloured by its direction."""
    u, v = np.meshgrid(np.arange(around_it), np.arange(through), indexing="ij")
    a, b = 2 * np.pi * u / around_it, 2 * np.pi * v / through
    places = np.stack(
        [(1 + 0.4 * np.cos(b)) * np.cos(a), 0.4 * np.sin(b), (1 + 0.4 * np.cos(b)) * np.sin(a)], -1
    )
    here, right, up, both = (
        (u + i) % around_it * through + (v + k) % through for i, k in ((0, 0), (1, 0), (0, 1), (1, 1))
    )
    faces = np.concatenate([np.stack([here, up, right], -1), np.stack([right, up, both], -1)]).reshape(-1, 3)
    points = places.reshape(-1, 3).astype(np.float32)
    return asset_from_mesh(Mesh(points, faces, (0.5 + points / 3).astype(np.float32)))


def measure(asset: msb.Asset, name: str, pictures: Path) -> dict[str, Any]:
    """Return the verdict, the trials and, for `COMPARED` meshes, the repairs; write images."""
    pictures.mkdir()
    found: dict[str, Any] = {"faces": asset.manifest.face_count, "verdict": msb.audit(asset).verdict}
    views = choose_views(asset, size=(960, 720))
    tried = try_asset(asset, cameras=views, keep=pictures, meshes=False).to_dict()
    keys = ("task", "outcome", "why", "seconds", "numbers", "libraries")
    found["trials"] = [{key: one[key] for key in keys} for one in tried["trials"]]
    if name in COMPARED:
        rows = compare(asset, views, Options(), keep=pictures)
        found["repairs"] = [row.to_dict() for row in rows]
    return found


def sheet(rows: list[list[Path]]) -> Image.Image:
    """Return images side by side, each cropped around its content."""
    width, height = TILE
    made = Image.new("RGB", (width * max(map(len, rows)), height * len(rows)), "white")
    for number, row in enumerate(rows):
        for column, path in enumerate(row):
            picture = Image.open(path).convert("RGB")
            if picture.width > 2 * picture.height:  # two libraries: keep the first
                picture = picture.crop((0, 0, picture.width // 2, picture.height))
            picture.thumbnail((width - 6, height - 6), Image.Resampling.LANCZOS)
            place = (
                column * width + (width - picture.width) // 2,
                number * height + (height - picture.height) // 2,
            )
            made.paste(picture, place)
    return made.quantize(128, dither=Image.Dither.NONE)


def main() -> None:
    """Measure the selected meshes, and create their images."""
    given = dict(word.split("=", 1) for word in sys.argv[1:] if "=" in word)
    wanted = [word for word in sys.argv[1:] if "=" not in word]
    sources: dict[str, Path | None] = {
        "torus": None,
        **paths(),
        **{name: Path(at) for name, at in given.items()},
    }
    names = [*wanted, *given] or list(sources)
    figures = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in names:
            source = sources[name]
            asset = torus() if source is None else msb.open(source)
            figures[name] = measure(asset, name, folder / name)
            text = json.dumps(figures, indent=1, sort_keys=True)
            FIGURES.write_text(f"{text}\n", encoding="utf-8")
        if set(PICTURED) <= set(names):
            tried = [[folder / name / f"{task}.png" for task in tasks] for name, tasks in PICTURED.items()]
            sheet(tried).save(IMAGES / "trial.png", optimize=True)
        if "splat_like" in names:
            ways = [folder / "splat_like" / f"{way}.png" for way in SHOWN]
            sheet([ways]).save(IMAGES / "repair.png", optimize=True)


if __name__ == "__main__":
    main()
