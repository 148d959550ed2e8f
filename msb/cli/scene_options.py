"""Options of a dataset's scene, and what a run makes of it: the views that count, and what is behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.camera_options import Views
    from msb.cli.output import Output
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

Split = Literal["train", "test", "all"]
ImageFolder = Annotated[
    str | None, typer.Option(metavar="NAME", help="With --scene: the photographs' folder, e.g. images_2.")
]


def scene_for(asset: Asset, path: Path, image_folder: str | None, output: Output) -> Scene:
    """Return a scene as a run evaluates the asset on it, and print its warnings."""
    from msb.base.paths import given_path
    from msb.scenes.datasets import dataset_of, scaled_note, scene_at, stated_background

    manifest = asset.manifest
    own = stated_background(manifest)
    dataset = dataset_of(path)
    at = scene_at(given_path(path), dataset, manifest.method, own_background=own, image_folder=image_folder)
    scene = at.read()
    for warning in scene.warnings:
        output.note(warning.to_line(warning.file or path))
    if (note := scaled_note([scene])) is not None:
        output.note(f"{path}: {note}")
    return scene


def note_training(asset: Asset, scene: Scene, path: Path, output: Output) -> None:
    """Print what the asset's training did otherwise, unless its reader has warned of it already."""
    from msb.scenes.datasets import stated_background, trained_otherwise

    said = {warning.message for warning in asset.warnings}
    manifest = asset.manifest
    for finding in trained_otherwise(manifest.training, stated_background(manifest), scene):
        if finding.message not in said:
            output.note(finding.to_line(path))


def views_of(scene: Scene, views: Views) -> tuple[Split, list[Camera]]:
    """Return the cameras that are asked for, and their split: the test views unless --camera names others.

    ``train`` and ``all`` are the training views, and these before the test views. A number is that of a test
    view, or after these of a training view.
    """
    train, test = list(scene.train), list(scene.test)
    words = set(views.camera)
    if words <= {"train", "test", "all"}:
        split: Split = "test" if words <= {"test"} else "train" if words == {"train"} else "all"
        return split, {"train": train, "test": test, "all": [*train, *test]}[split]
    cameras = views.of([*test, *train])
    known = {camera.name for camera in test}
    return ("test" if all(camera.name in known for camera in cameras) else "all"), cameras


def about_scene(scene: Scene, split: Split) -> dict[str, Any]:
    """Return what JSON says of the scene that was drawn."""
    return {
        "path": str(scene.root),
        "dataset": scene.dataset,
        "split": split,
        "image_folder": scene.image_folder,
        "camera_convention": scene.camera_convention,
    }
