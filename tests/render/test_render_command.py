"""`msb render`: images, floats, films, tiers, cameras of scenes, and exit statuses."""

import hashlib
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import msb as library
from msb.registry import Tier
from msb.scenes import read_scene, turntable, write_cameras
from msb.scenes.around import make_turntable
from tests.adapters.models import GOLDEN
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]

CHECKPOINT = ROOT / "data_stubs" / "checkpoint"
SCENE = ROOT / "tests" / "tiny" / "scenes" / "mipnerf360" / "pebble"


@pytest.fixture(scope="module")
def cameras(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a views.json with three small cameras around the demo checkpoint."""
    path = tmp_path_factory.mktemp("cameras") / "views.json"
    views = turntable((0.5, 0.5, 0.5), 2.2, up=(0, 1, 0), count=3, width=60, height=44, fov_y=0.7)
    write_cameras(views, path)
    return path


@pytest.mark.slow
def test_every_camera_gives_an_image_with_its_name(
    here: Here, demo_asset: Path, cameras: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = here("render", "--cameras", cameras, "-o", out, "--background", "white", demo_asset)
    assert (result.status, result.err) == (0, "")
    assert re.fullmatch(rf"{out}: 3 views, sha256 [0-9a-f]{{16}}\n", result.out)
    assert sorted(path.name for path in out.iterdir()) == [f"turntable_{i:05d}.png" for i in range(3)]
    with Image.open(out / "turntable_00001.png") as image:
        assert (image.size, image.mode) == ((60, 44), "RGB")
        pixels = np.asarray(image)
    asset = library.load(demo_asset)
    camera = library.read_cameras(cameras)[1]
    frame = library.render(asset, camera, background=(1, 1, 1))
    expected = np.floor(np.clip(frame.image, 0, 1) * np.float32(255) + np.float32(0.5))
    np.testing.assert_array_equal(pixels, expected)
    assert (pixels[0, 0] == 255).all()
    assert (pixels != 255).any()


@pytest.mark.slow
def test_floats_depth_and_ids_are_written_as_rendered(
    here: Here, demo_asset: Path, cameras: Path, tmp_path: Path
) -> None:
    args = ("--cameras", cameras, "--camera", "1", "-o", tmp_path, "--format", "npy", "--depth", "--ids")
    result = here("render", *args, "--json", "-", demo_asset, status=0)
    frame = library.render(library.load(demo_asset), library.read_cameras(cameras)[1])
    for suffix, plane in (("", frame.image), ("_depth", frame.depth), ("_ids", frame.face_id)):
        stored = np.load(tmp_path / f"turntable_00001{suffix}.npy", allow_pickle=False)
        np.testing.assert_array_equal(stored, plane)
        assert stored.dtype == plane.dtype
    row = result.json["frames"][0]
    assert result.json["schema"] == "msb.render/1"
    assert (row["camera"], row["width"], row["height"]) == ("turntable_00001", 60, 44)
    assert row["image"] == str(tmp_path / "turntable_00001.npy")
    assert 0 < row["coverage"] < 1
    assert result.json["memory"]
    assert row["sha256"] == hashlib.sha256(frame.image.tobytes()).hexdigest()
    machine = result.json["machine"]
    assert machine["device"]["driver"]
    assert "-cl-kernel-arg-info" in machine["build_options"]
    assert re.fullmatch("[0-9a-f]{64}", machine["kernels_sha256"])
    here("render", *args, demo_asset, status=2)  # the files exist
    here("render", *args, "--force", demo_asset, status=0)


@pytest.mark.slow
def test_choosing_sizes_and_flights(here: Here, demo_asset: Path, cameras: Path, tmp_path: Path) -> None:
    base = f"render -q --cameras {cameras}"
    here(f"{base} --camera turntable_00002 --camera 0 --size 30x20 -o", tmp_path / "a", demo_asset)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["turntable_00000.png", "turntable_00002.png"]
    with Image.open(tmp_path / "a" / "turntable_00000.png") as image:
        assert image.size == (30, 20)
    here(f"{base} --camera all --scale 0.5 -o", tmp_path / "b", demo_asset)
    assert len(list((tmp_path / "b").iterdir())) == 3
    here(f"{base} --flight 5 --film", tmp_path / "f.gif", demo_asset, status=0)
    with Image.open(tmp_path / "f.gif") as film:
        assert (film.n_frames, film.size) == (5, (60, 44))


@pytest.mark.slow
def test_both_tiers_and_names_of_files(here: Here, demo_asset: Path, cameras: Path, tmp_path: Path) -> None:
    base = ("render", "--cameras", cameras, "--size", "30x22", "-o", tmp_path)
    both = ("--tier", "both", "--order", "none", "--format", "npy")
    documents = here(*base, *both, "--json", "-", demo_asset, status=0).json
    assert [(document["tier"], document.get("order")) for document in documents] == [
        ("dedicated", "none"),
        ("standard", None),
    ]
    for document in documents:
        names = [f"turntable_{number:05d}_{document['tier']}.npy" for number in range(3)]
        assert [frame["image"] for frame in document["frames"]] == [str(tmp_path / name) for name in names]
        stored = np.load(tmp_path / names[0], allow_pickle=False)
        assert hashlib.sha256(stored.tobytes()).hexdigest() == document["frames"][0]["sha256"]
    here(*base, "--name", "{tier}/{index}", demo_asset, status=0)
    assert len(list((tmp_path / "standard").iterdir())) == 3
    for args in (
        ("--name", "x"),  # this pattern gives all images the same name
        ("--tier", "both", "--name", "{camera}"),
        ("--name", "{frame}"),
        ("--name", "../{camera}"),
    ):
        here(*base, *args, demo_asset).ends(2, "USAGE: ")


@pytest.mark.slow
def test_supersampling_averages_samples(here: Here, tmp_path: Path) -> None:
    """The option also works for a mesh, whose method has no setting of that name."""
    mesh = GOLDEN / "meshes" / "synthetic_splat_small.ply"
    views = ("--turntable", "1", "--format", "npy", "-q")
    here("render", *views, "--size", "30x22", "--supersample", "2", "-o", tmp_path / "a", mesh, status=0)
    here("render", *views, "--size", "60x44", "-o", tmp_path / "b", mesh, status=0)
    sampled, large = (np.load(tmp_path / name / "00000.npy") for name in ("a", "b"))
    np.testing.assert_allclose(sampled, large.reshape(22, 2, 30, 2, 3).mean(axis=(1, 3)), atol=1e-6)


@pytest.mark.slow
def test_turntable_of_a_checkpoint_and_other_tiers(here: Here, tmp_path: Path) -> None:
    size = ("--turntable", "2", "--size", "40x32", "--background", "#ff8000")
    for tier in ("standard", "reference"):
        here("render", *size, "--tier", tier, "-o", tmp_path / tier, CHECKPOINT, status=0)
        with Image.open(tmp_path / tier / "00000.png") as image:
            assert image.getpixel((0, 0)) == (255, 128, 0)
            assert len(set(np.asarray(image).reshape(-1, 3).sum(axis=1).tolist())) > 50
    soup = GOLDEN / "diffsoup" / "ico_l2_white" / "checkpoint"
    rejected = here("render", *size, "-o", tmp_path / "no", soup)
    rejected.ends(4, f"UNSUPPORTED_TIER: {soup}: diffsoup on tier standard: ")
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["dedicated", "reference"])
def test_orders_and_samplings_of_an_engine(here: Here, tmp_path: Path, tier: Tier) -> None:
    checkpoint = GOLDEN / "two_dts" / "orb_diffuse" / "checkpoint"
    asset = library.export(checkpoint)
    (camera,) = make_turntable(asset, 1, 40, 30)
    views = ("--turntable", "1", "--size", "40x30", "--tier", tier, "--format", "npy", "--json", "-")
    images = []
    for modes in ({}, {"order": "none"}, {"sampling": "engine"}, {"order": "global", "sampling": "engine"}):
        out = tmp_path / "_".join(modes)
        options = [part for name, value in modes.items() for part in (f"--{name}", value)]
        result = here("render", *views, *options, "-o", out, checkpoint, status=0)
        assert {name: result.json[name] for name in ("order", "sampling") if name in result.json} == modes
        images.append(np.load(out / "00000.npy", allow_pickle=False))
        np.testing.assert_array_equal(images[-1], library.render(asset, camera, tier, **modes).image)
    assert np.abs(images[1] - images[0]).max() > 0.05
    assert np.abs(images[2] - images[0]).max() > 0.01
    np.testing.assert_array_equal(images[3], images[2])


@pytest.mark.slow
def test_differences_between_training_and_scene_are_noted(here: Here, tmp_path: Path) -> None:
    model = tmp_path / "model"
    shutil.copytree(ROOT / "tests/tiny/models/walled/triangle_splatting", model)
    trained = "images='images', resolution=-1, white_background=False, eval=False"
    (model / "cfg_args").write_text(f"Namespace({trained})")
    asset = tmp_path / "model.triasset"
    on_test_views, background, size = "eval=False", "black", "256 x 192"
    assert here("export", model, asset).err.count(on_test_views) == 1
    scene = ("--scene", SCENE, "--camera", "0", "-o", tmp_path / "out", "--force")
    for place in (model, asset):
        drawn = here("render", *scene, "--background", "white", place)
        assert drawn.err.count(on_test_views) == 1
        assert background in drawn.err
        assert size in drawn.err
    assert background not in here("render", *scene, asset).err


@pytest.mark.slow
def test_a_scene_gives_the_requested_split_over_the_model_background(here: Here, tmp_path: Path) -> None:
    model = tmp_path / "model"
    shutil.copytree(ROOT / "tests" / "tiny" / "models" / "walled" / "mesh_splatting", model)
    (model / "cfg_args").write_text("Namespace(white_background=True)")
    whole = read_scene(SCENE)
    for split, views in (("train", whole.train), ("all", (*whole.train, *whole.test))):
        args = ("--scene", SCENE, "--camera", split, "-o", tmp_path / split, "--json", "-")
        drawn = here("render", *args, model).json
        assert drawn["background"] == [1, 1, 1]
        assert [(row["camera"], row["width"], row["height"]) for row in drawn["frames"]] == [
            (view.name, view.width, view.height) for view in views
        ]
        names = {str(view.name).rpartition(".")[0] for view in views}
        assert {file.stem for file in (tmp_path / split).iterdir()} == names
    options = ("--camera", str(whole.test[0].name), "--background", "#804020")
    drawn = here("render", "--scene", SCENE, *options, "-o", tmp_path / "one", "--json", "-", model).json
    assert drawn["background"] == [128 / 255, 64 / 255, 32 / 255]
    assert len(drawn["frames"]) == 1


@pytest.mark.slow
def test_wrong_usage_is_reported_before_rendering(
    here: Here, demo_asset: Path, cameras: Path, tmp_path: Path
) -> None:
    places = {"VIEWS": f"--cameras {cameras}", "OUT": f"-o {tmp_path}/out", "NEW": f"{tmp_path}/new"}
    for line, status, code in (
        ("OUT --turntable 3,x", 2, "USAGE"),
        ("OUT --turntable 99999999", 2, "USAGE"),
        ("OUT --turntable 0", 2, "USAGE"),
        ("OUT --turntable 2,90", 2, "USAGE"),
        ("VIEWS OUT --scale 1e9", 2, "USAGE"),
        ("VIEWS OUT --size big", 2, "USAGE"),
        ("VIEWS OUT --size 0x5", 2, "USAGE"),
        ("VIEWS OUT --size 100000x9", 2, "USAGE"),
        ("OUT --turntable 1 --size 5x0", 2, "USAGE"),
        ("VIEWS OUT --background mauve", 2, "USAGE"),
        ("VIEWS OUT --background official", 2, "USAGE"),
        ("VIEWS OUT --camera unknown", 2, "NAME_UNKNOWN"),
        ("VIEWS OUT --camera 3", 2, "NAME_UNKNOWN"),
        ("VIEWS OUT --renderer quake", 2, "NAME_UNKNOWN"),
        ("VIEWS OUT --order tile", 4, "UNSUPPORTED_OPTION"),
        ("VIEWS OUT --sampling engine", 4, "UNSUPPORTED_OPTION"),
        ("VIEWS OUT --set sigmo=1", 2, "SETTING_UNKNOWN"),
        (f"OUT --scene {SCENE} --image-folder none", 3, "SCENE_IMAGE_MISSING"),
        ("OUT --cameras NEW", 3, "FILE_NOT_FOUND"),
        ("VIEWS OUT --device nowhere:7", 5, "DEVICE_NOT_FOUND"),
        ("VIEWS OUT --device a:b:c", 2, "DEVICE_SELECTOR"),
    ):
        words = re.sub("[A-Z]{3,}(?![A-Z_])", lambda word: places.get(word[0], word[0]), line)
        here(f"render {words}", demo_asset).ends(status, f"{code}: ")
    assert list(tmp_path.iterdir()) == []


def test_empty_images_cause_a_warning(here: Here, tmp_path: Path) -> None:
    away = library.Camera.look_at((0, 0, 90), (0, 0, 99), up=(0, 1, 0), width=16, height=12, fov_y=0.6)
    write_cameras([away], tmp_path / "away.json")
    line = (
        "--cameras",
        tmp_path / "away.json",
        "-o",
        tmp_path / "out",
        ROOT / "data_stubs/models/pebble/two_dts",
    )
    assert any(text.startswith("warning: ") for text in here("render", *line).err.splitlines())
