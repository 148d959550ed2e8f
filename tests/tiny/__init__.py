"""Tiny scenes, a model of each method for them, and their benchmark protocol, for tests."""

from pathlib import Path

TINY = Path(__file__).parent
SCENES = TINY / "scenes"
MODELS = TINY / "models"


def link_demo(folder: Path) -> None:
    """Create `folder`/data_stubs: the demo data with tiny models and scenes instead of the shipped ones.

    Examples run faster with them. Models of the demo data have ten times as many faces, and its scenes have
    twice as many views.
    """
    tiny = {"models": MODELS, "scenes": SCENES}
    place = folder / "data_stubs"
    place.mkdir()
    for path in (TINY.parents[1] / "data_stubs").iterdir():
        if path.suffix == ".toml":  # its paths are relative to the file
            # Tiny models have no record of their training.
            lines = path.read_text().splitlines(keepends=True)
            kept = [line for line in lines if not line.startswith("training = ")]
            (place / path.name).write_text("".join(kept))
        elif path.suffix != ".py" and path.name != "__pycache__":
            (place / path.name).symlink_to(tiny.get(path.name, path))
