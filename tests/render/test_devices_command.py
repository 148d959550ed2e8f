"""`msb devices`."""

import pytest

from msb.base.version import __version__
from tests.cli.conftest import Here, Msb, devices, here, msb, tried

__all__ = ["devices", "here", "msb", "tried"]


@pytest.mark.slow
def test_the_table_marks_the_default_device(devices: Here) -> None:
    result = devices()
    assert (result.status, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0].split() == ["--device", "Kind", "Units", "Memory", "Driver", "Builds", "Device"]
    (taken,) = (line.split() for line in lines if line.startswith("pocl:0 *"))
    assert {"yes", "fixed"} & {*taken}
    assert max(map(len, (*lines, *devices("-v").out.splitlines()))) <= 80
    assert len(devices("-q").out) < len(result.out) < len(devices("-v").out)


@pytest.mark.slow
def test_json(devices: Here) -> None:
    result = devices("--json", "-")
    assert result.status == 0
    data = result.json
    assert (data["schema"], data["tool_version"]) == ("msb.devices/1", __version__)
    assert data["chosen"] == "pocl:0"
    assert data["chosen_by"] == "default"
    taken = next(device for device in data["devices"] if device["selector"] == "pocl:0")
    assert (taken["builds"], taken["why"], taken["advice"]) == (True, None, None)
    assert isinstance(data["notes"], list)


@pytest.mark.slow
def test_a_device_that_cannot_build_is_listed_with_reason_and_remedy(
    msb: Msb, unknown: dict[str, str]
) -> None:
    """Without such a device, renderers on OpenCL cannot draw, and choosing the device fails with the same
    message.
    """
    off = {**unknown, "MSB_MEND_POCL": "0"}
    result = msb("devices", "--device", "pocl", **off, status=5)
    assert "pocl:0 " in result.out
    assert "apt-get" in result.out
    assert result.err.startswith("DEVICE_BUILD: pocl:0 ")
    assert result.err.count("\n") == 1
    data = msb("devices", "--json", "-", "--device", "pocl", **off).json
    broken = next(device for device in data["devices"] if device["selector"] == "pocl:0")
    assert not broken["builds"]
    assert "'generic'" in broken["why"]
    drawing = {renderer["name"]: renderer["missing"] for renderer in data["renderers"]}
    assert drawing["dedicated"] == drawing["standard"] != ""
    assert drawing["reference"] is None


@pytest.mark.slow
def test_a_fixed_device_is_marked(msb: Msb, unknown: dict[str, str]) -> None:
    result = msb("devices", "-v", "--device", "pocl", **unknown, status=0)
    assert "haswell" in result.out
    assert "fixed" in next(line for line in result.out.splitlines() if line.startswith("pocl:0")).split()


@pytest.mark.slow
def test_an_environment_variable_that_selects_the_device_is_reported(
    devices: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MSB_DEVICE", "pocl")
    assert "MSB_DEVICE pocl" in devices().out
    assert devices("--json", "-").json["chosen_by"] != "default"


@pytest.mark.slow
@pytest.mark.parametrize("json_wanted", [False, True])
def test_an_unknown_device_ends_with_status_5_after_the_list(devices: Here, json_wanted: bool) -> None:
    result = devices("--device", "nosuch:3", *(["--json", "-"] if json_wanted else []))
    assert result.status == 5
    assert result.err.startswith("DEVICE_NOT_FOUND: ")
    assert result.err.count("\n") == 1
    assert "pocl:0" in result.out
    if json_wanted:
        assert result.json["chosen"] is None
