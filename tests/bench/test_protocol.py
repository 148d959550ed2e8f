"""The protocol file: defaults, paths with placeholders, and one clear error for each mistake."""

import shutil
from pathlib import Path

import pytest

from msb.bench.protocol import (
    get_overrides,
    make_single_protocol,
    parse_protocol,
    read_example,
    read_protocol,
)
from msb.errors import MsbError
from msb.registry import METHODS
from msb.scenes.datasets import DATASETS
from tests.bench.protocols import PEBBLE, STUBS
from tests.conftest import WHOLE

MINIMAL = """
[[datasets]]
name = "mipnerf360"
path = "data/360_v2"
scenes = ["garden"]

[[methods]]
name = "two_dts"
model = "out/{method}/{scene}"
"""


def test_a_minimal_protocol_and_its_defaults() -> None:
    file = parse_protocol(MINIMAL.encode(), "/somewhere/p.toml")
    protocol = file.protocol
    assert file.results == Path("/somewhere/results")
    assert protocol.conditions == ("non_engine", "dedicated", "standard", "exported_mesh")
    assert (protocol.timing.frames, protocol.timing.seconds) == (100, 3.0)
    assert protocol.chamfer is None
    assert protocol.metrics.vgg_weights is None


def test_paths_are_relative_to_the_file_and_have_placeholders() -> None:
    file = parse_protocol(MINIMAL.encode(), "/a/b/p.toml")
    names = {"dataset": "d", "scene": "s", "method": "m"}
    assert file.resolve("x/{scene}/{method}/{dataset}", **names) == Path("/a/b/x/s/m/d")
    assert file.resolve("../x", **names) == Path("/a/x")
    assert file.resolve("/abs/{scene}", **names) == Path("/abs/s")
    assert file.resolve("~/x", **names) == Path.home() / "x"


def test_doubled_braces_are_single_braces() -> None:
    text = MINIMAL.replace("{scene}", "{{x}}/{scene}{{")
    file = parse_protocol(text.encode(), "/a/b/p.toml")
    model = file.protocol.methods[0].model
    assert str(file.resolve(model, dataset="d", scene="s", method="m")).endswith("/{x}/s{")
    assert file.resolve("{{scene}}/{scene}", scene="s") == Path("/a/b/{scene}/s")


def test_the_setting_none_means_null() -> None:
    text = MINIMAL + 'settings = { ste_threshold = "none", gamma = 20 }\n'
    method = parse_protocol(text.encode(), "p.toml").protocol.methods[0]
    assert get_overrides(method) == {"ste_threshold": None, "gamma": 20}


def test_the_paper_example_has_the_papers_scenes_rows_and_sizes() -> None:
    protocol = parse_protocol(read_example("paper"), "paper.toml").protocol
    assert {table.name: set(table.scenes) for table in protocol.datasets} == {
        name: set(dataset.scenes) for name, dataset in DATASETS.items()
    }
    methods = {name for name, method in METHODS.items() if method.paper_name}
    assert {method.name for method in protocol.methods} == methods
    assert {table.name: table.resolution for table in protocol.datasets}["tanksandtemples"] is None
    diffsoup = {
        name: (method.image_folder, method.resolution)
        for method in protocol.methods
        if method.name == "diffsoup"
        for name in method.datasets
    }
    assert diffsoup == {
        "mipnerf360": ("images_4", None),
        "tanksandtemples": (None, 2),  # the published images are at 2x downsampling
        **dict.fromkeys(("nerf_synthetic", "dtu"), (None, 4)),
    }


OURS = '[[methods]]\nname = "mesh"\nmodel = "x"\nlabel = "Ours"\n'
VARIANT = '[[variants]]\nlabel = "{}"\norder = "global"\n'
WRONG = {
    "a = ": "the file is not valid TOML",
    "a = " + "[" * 4000: "the file is not valid TOML",
    "\xff": "the file is not valid TOML",
    "": "/datasets",
    "[timng]\nframes = 3\n" + MINIMAL: "/timng",
    MINIMAL + "nonsense = 1\n": "/methods/0/nonsense",
    MINIMAL + "resolution = 2020-01-01\n": "the file contains",
    MINIMAL.replace("two_dts", "nerf"): "/methods/0/name",
    MINIMAL.replace("{scene}", "{sceen}"): "/methods/0/model",
    MINIMAL.replace('"two_dts"', '"auto"'): "/methods/0/model",
    MINIMAL.replace('name = "mipnerf360"', 'name = ".."'): "/datasets/0/name",
    MINIMAL.replace('["garden"]', '["a/b"]'): "/datasets/0/scenes/0",
    MINIMAL.replace('["garden"]', '"garden"'): "/datasets/0/scenes",
    MINIMAL + "settings = { gama = 1 }\n": "/methods/0/settings",
    MINIMAL + "settings = { gamma = 0.5 }\n": "/methods/0/settings",
    MINIMAL + 'conditions = ["dedicatet"]\n': "/methods/0/conditions/0",
    MINIMAL + 'datasets = ["dtu"]\n': "/methods/0/datasets",
    MINIMAL + "background = [1, 1, 2]\n": "/methods/0/background/2",
    MINIMAL + "[timing]\nframes = -1\n": "/timing/frames",
    MINIMAL + "[timing]\nseconds = nan\n": "the file contains",
    MINIMAL + "[chamfer]\n": "/chamfer/data",
    MINIMAL + '[trial]\ntasks = ["uvs"]\n': "/trial/tasks",
    MINIMAL + '[videos]\npath = "spiral"\n': "/videos/path",
    MINIMAL + "[walk]\nframes = 2\n": "/walk/frames",
    MINIMAL + '[walk]\nconditions = ["engin"]\n': "/walk/conditions",
    'engines = ["standard"]\n' + MINIMAL: "/engines",
    MINIMAL.replace('model = "out/{method}/{scene}"', ""): "/methods/0",
    MINIMAL + 'label = "mesh"\n': "/methods/0/label",
    MINIMAL + 'label = "a/b"\n': "/methods/0/label",
    MINIMAL + 'label = "ours"\n' + OURS: "/methods/1/label",
    MINIMAL + VARIANT.format("Standard"): "/variants/0/label",
    MINIMAL + VARIANT.format("a") + VARIANT.format("A"): "/variants/1/label",
    MINIMAL + '[[variants]]\nlabel = "a"\n': "/variants/0",
    MINIMAL + '[[variants]]\norder = "global"\n': "/variants/0/label",
    MINIMAL + '[[variants]]\nlabel = "a"\norder = "up"\n': "/variants/0/order",
    MINIMAL + '[[variants]]\nlabel = "a"\nrenderer = "b"\n': "/variants/0/renderer",
    MINIMAL + VARIANT.format("a") + "settings = { gama = 1 }\n": "/variants/0/settings",
}
"""The beginning of the message for each invalid protocol, usually the place in the file."""


@pytest.mark.parametrize("text", [text for text in WRONG if WHOLE or "[trial]" not in text])
def test_errors_name_their_place(text: str) -> None:
    with pytest.raises(MsbError) as caught:
        parse_protocol(text.encode("latin-1" if text == "\xff" else "utf-8"), "p.toml")
    assert caught.value.code == "PROTOCOL_INVALID"
    assert caught.value.message.startswith(WRONG[text])
    assert len(str(caught.value).splitlines()) == 1


def test_missing_and_too_long_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(MsbError, match="FILE_NOT_FOUND"):
        read_protocol(tmp_path / "p.toml")
    (tmp_path / "p.toml").write_bytes(b"#" * (2 << 20))
    with pytest.raises(MsbError, match="PROTOCOL_INVALID"):
        read_protocol(tmp_path / "p.toml")


def test_a_protocol_of_one_model_on_one_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = make_single_protocol(
        PEBBLE / "two_dts", STUBS / "scenes" / "dtu" / "scan1", non_engine="reference"
    )
    assert file.results == tmp_path / "two_dts-scan1-results"
    assert file.protocol.datasets[0].name == "dtu"
    assert file.protocol.methods[0].non_engine == "reference"
    assert parse_protocol(file.text, file.path) == file
    with pytest.raises(MsbError, match="SCENE_LAYOUT"):
        make_single_protocol(PEBBLE / "two_dts", tmp_path)


def test_braces_in_file_names_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / "{x}{scene}}"
    shutil.copytree(STUBS / "scenes" / "dtu" / "scan1", folder / "scan1")
    file = make_single_protocol(folder / "model", folder / "scan1", non_engine=str(folder / "renders"))
    dataset, method = file.protocol.datasets[0], file.protocol.methods[0]
    for given, name in ((dataset.path, "scan1"), (method.model, "model"), (method.non_engine, "renders")):
        assert file.resolve(given, scene="s", dataset="d", method="m") == folder / name


def test_weights_of_lpips_are_found_in_the_cache_of_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = parse_protocol(f'{MINIMAL}\n[metrics]\nvgg_weights = "auto"\n'.encode(), tmp_path / "p.toml")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "cache"))
    for name in ("torch", "lpips"):
        (tmp_path / "packages" / name).mkdir(parents=True)
        (tmp_path / "packages" / name / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path / "packages")
    assert file.vgg_weights is None, "the file is absent"
    place = tmp_path / "cache" / "hub" / "checkpoints" / "vgg16-397923af.pth"
    place.parent.mkdir(parents=True)
    place.touch()
    assert file.vgg_weights == place
