"""Tiny scenes, a model of each method for them, and the protocol that runs them, for tests."""

import shutil
from pathlib import Path

TINY = Path(__file__).parent
SCENES = TINY / "scenes"
MODELS = TINY / "models"


def link_demo(folder: Path) -> None:
    """Make `folder`/data_stubs: the demo's data, with tiny models and scenes in the place of its own.

    Its own have ten times the faces and twice the views, and examples are to run, not to look well.
    """
    tiny = {"models": MODELS, "scenes": SCENES}
    place = folder / "data_stubs"
    place.mkdir()
    for path in (TINY.parents[1] / "data_stubs").iterdir():
        if path.suffix == ".toml":  # its paths are relative to the file itself
            shutil.copy(path, place)
        elif path.suffix != ".py" and path.name != "__pycache__":
            (place / path.name).symlink_to(tiny.get(path.name, path))
