"""LPIPS with synthetic weights compared with golden values and the lpips package, and weight files."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb import metrics
from msb.errors import InputError, MetricError
from msb.metrics.vgg import HEADS_SHA256, VGG_FILE, VGG_SHA256, read_heads, read_vgg, weights_source
from tests.metrics.conftest import GOLDEN, golden, needs_torch, synthetic_vgg

CASES = golden("lpips_synthetic_vgg.json")["cases"]
IMAGES = np.load(GOLDEN / "lpips_synthetic_vgg.npz")


@pytest.fixture(scope="module")
def network(vgg_file: Path) -> metrics.LpipsVgg:
    import torch

    # With few cores, threads of several test processes wait for each other ten times as long as they compute.
    torch.set_num_threads(1)
    return metrics.LpipsVgg(vgg_file)


@needs_torch
@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_golden(case: dict[str, Any], network: metrics.LpipsVgg) -> None:
    pred, gt = IMAGES[f"{case['id']}__pred"], IMAGES[f"{case['id']}__gt"]
    value = network(pred / 255, gt / 255)
    assert value == pytest.approx(case["lpips"], rel=1e-4, abs=1e-6)
    assert network.per_layer(pred, gt) == pytest.approx(case["per_layer"], rel=1e-4, abs=1e-6)
    assert network(gt, pred) == pytest.approx(value, rel=1e-6)
    if case["lpips"] == 0:
        assert value == 0
    else:
        assert abs(value - case["lpips_input_0_1"]) > 0.1 * value


@needs_torch
def test_lpips_equals_the_package(network: metrics.LpipsVgg) -> None:
    import torch

    try:
        import lpips
    except Exception as error:
        pytest.skip(f"the lpips package does not load: {error}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = lpips.LPIPS(net="vgg", pnet_rand=True, verbose=False).eval()
    weights = synthetic_vgg()
    state = {
        key: torch.from_numpy(weights["features." + key.partition(".")[2]]) for key in theirs.net.state_dict()
    }
    theirs.net.load_state_dict(state)
    for shape in ((16, 16), (33, 50), (64, 47)):
        images = np.random.default_rng(shape[0]).integers(0, 256, (2, *shape, 3), dtype=np.uint8)
        tensors = torch.from_numpy(images / 255).float().permute(0, 3, 1, 2) * 2 - 1
        with torch.no_grad():
            expected = float(theirs(tensors[:1], tensors[1:]))
        assert network(*images) == pytest.approx(expected, rel=1e-5)


@needs_torch
def test_unknown_weights_give_a_warning_and_are_recorded(vgg_file: Path) -> None:
    image = np.zeros((16, 16, 3))
    with pytest.warns(metrics.MetricWarning, match="METRIC_VGG_UNKNOWN: .*synthetic"):
        assert metrics.lpips_vgg(image, image, vgg_weights=vgg_file) == 0
    network = metrics.LpipsVgg(vgg_file)
    assert [warning.code for warning in network.warnings] == ["METRIC_VGG_UNKNOWN"]
    record = network.identity().to_dict()
    assert record["weights"]["vgg"]["known"] is None
    assert record["weights"]["heads"]["known"] == "lpips 0.1.4"
    assert record["libraries"]["torch"]


@needs_torch
def test_small_and_unequal_images_are_rejected(network: metrics.LpipsVgg) -> None:
    with pytest.raises(MetricError, match="METRIC_IMAGE"):
        network(np.zeros((15, 20, 3)), np.zeros((15, 20, 3)))
    with pytest.raises(MetricError, match="METRIC_SIZES_DIFFER"):
        network(np.zeros((16, 20, 3)), np.zeros((20, 16, 3)))


@needs_torch
@pytest.mark.parametrize("modern", [True, False])
def test_torch_files_hold_the_same_tensors(vgg_file: Path, tmp_path: Path, modern: bool) -> None:
    import torch

    path = tmp_path / "vgg.pth"
    state = {key: torch.from_numpy(value) for key, value in synthetic_vgg().items()}
    state["classifier.0.weight"] = torch.zeros(2, 2)
    torch.save(state, path, _use_new_zipfile_serialization=modern)
    assert read_vgg(path)[1]["tensors_sha256"] == read_vgg(vgg_file)[1]["tensors_sha256"]


@needs_torch
def test_torch_file_is_never_executed(tmp_path: Path) -> None:
    path = tmp_path / "vgg.pth"
    marker = tmp_path / "executed"
    path.write_bytes(b"cos\nsystem\n(V" + f"touch {marker}".encode() + b"\ntR.")
    with pytest.raises(MetricError, match="METRIC_WEIGHTS"):
        read_vgg(path)
    assert not marker.exists()


@needs_torch
def test_linear_layers_of_the_package_are_version_0_1() -> None:
    heads, sha256 = read_heads()
    assert [len(head) for head in heads] == [64, 128, 256, 512, 512]
    assert all((head >= 0).all() for head in heads)
    assert sha256 == HEADS_SHA256


def test_synthetic_weights_equal_the_golden_ones(vgg_file: Path) -> None:
    import hashlib

    weights, record = read_vgg(vgg_file)
    for key, prefix in golden("lpips_synthetic_vgg.json")["weight_sha256_prefix"].items():
        assert hashlib.sha256(weights[key].tobytes()).hexdigest().startswith(prefix)
    assert record["file"] == "synthetic.npz"
    assert record["known"] is None


def test_weights_source_distinguishes_published_weights() -> None:
    vgg = {"file": "v.pth", "sha256": VGG_SHA256, "known": "torchvision vgg16-397923af.pth"}
    heads = {"known": "lpips 0.1.4"}
    both = weights_source({"vgg": vgg, "heads": heads})
    other_heads = weights_source({"vgg": vgg, "heads": {"known": None}})
    other_vgg = weights_source({"vgg": {**vgg, "sha256": "0" * 64, "known": None}, "heads": heads})
    assert len({both, other_heads, other_vgg}) == 3
    assert VGG_SHA256[:16] in both
    # The rule of torch: the name of a published file ends in the first eight digits of its hash.
    assert f"vgg16-{VGG_SHA256[:8]}.pth" == VGG_FILE


def test_missing_weight_file_is_an_input_error(tmp_path: Path) -> None:
    for path in (tmp_path / "none.pth", tmp_path):
        with pytest.raises(InputError):
            read_vgg(path)
