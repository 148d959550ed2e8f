"""Options of a dataset's scene, and what a run makes of it: the views that count, and what is behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

Split = Literal["train", "test", "all"]
ImageFolder = Annotated[
    str | None, typer.Option(metavar="NAME", help="With --scene: the photographs' folder, e.g. images_2.")
]


def scene_for(asset: Asset, path: Path, image_folder: str | None) -> Scene:
    """Return a scene as a run evaluates the asset on it: views, size, camera convention and background."""
    from msb.base.paths import given_path
    from msb.scenes.datasets import dataset_of, scene_at, stated_background

    manifest = asset.manifest
    own = stated_background(manifest)
    dataset = dataset_of(path)
    at = scene_at(given_path(path), dataset, manifest.method, own_background=own, image_folder=image_folder)
    return at.read()


def note_training(asset: Asset, scene: Scene, path: Path, output: Output) -> None:
    """Print what the asset's training did otherwise, unless its reader has warned of it already."""
    from msb.scenes.datasets import stated_background, trained_otherwise

    said = {warning.message for warning in asset.warnings}
    manifest = asset.manifest
    for found in trained_otherwise(manifest.training, stated_background(manifest), scene):
        if found.message not in said:
            output.note(found.to_line(path))


def views_of(scene: Scene, split: Split) -> list[Camera]:
    """Return the cameras of a split, all of them the training views first."""
    train, test = scene.train, scene.test
    return [*(train if split != "test" else ()), *(test if split != "train" else ())]


def refuse_beside_scene(**others: object) -> None:
    """Refuse options, by their names, that ask for other views or other sizes than those that count."""
    given = [f"--{name}" for name, value in others.items() if value is not None]
    if given:
        text = f"{given[0]} does not go with --scene, which draws what counts, at the size that counts"
        raise UsageError("USAGE", text)


def about_scene(scene: Scene, split: Split) -> dict[str, Any]:
    """Return what JSON says of the scene that was drawn."""
    return {
        "path": str(scene.root),
        "dataset": scene.dataset,
        "split": split,
        "image_folder": scene.image_folder,
        "camera_convention": scene.camera_convention,
    }
