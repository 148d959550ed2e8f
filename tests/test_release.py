"""Release files (workflows, the GitHub action, the conda recipe) agree with pyproject.toml."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import msb
from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PLACE = "https://github.com/OWNER/meshsplatbench"


def read_yaml(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text())


def test_the_recipe_has_the_dependencies_of_the_core() -> None:
    recipe = read_yaml("packaging/conda/recipe.yaml")
    core = {re.split(r"[;\s]", word)[0] for word in PROJECT["dependencies"]}
    expected = {re.sub(r"([a-z])>", r"\1 >", word) for word in core if not word.startswith("pocl")}
    listed = {word for word in recipe["requirements"]["run"] if not word.startswith(("pocl", "python "))}
    assert listed == expected
    assert f"python {PROJECT['requires-python']}" in recipe["requirements"]["run"]
    assert recipe["context"]["version"] == msb.__version__
    scripts = {f"{name} = {place}" for name, place in PROJECT["scripts"].items()}
    assert set(recipe["build"]["python"]["entry_points"]) == scripts


def test_all_files_have_the_same_placeholder_address() -> None:
    assert set(PROJECT["urls"].values()) == {PLACE, f"{PLACE}/issues", f"{PLACE}/blob/main/CHANGELOG.md"}
    assert read_yaml("CITATION.cff")["repository-code"] == PLACE
    assert read_yaml("packaging/conda/recipe.yaml")["about"]["repository"] == PLACE
    package = json.loads((ROOT / "integrations" / "js" / "package.json").read_text())
    assert package["repository"]["url"] == f"git+{PLACE}.git"
    assert f"{PLACE}/actions/workflows/ci.yml" in (ROOT / "README.md").read_text()
    # The check before a release passes if grep fails, and grep also fails for a missing file. Therefore all
    # files that the check names must exist and contain the placeholder.
    steps = read_yaml(".github/workflows/release.yml")["jobs"]["build"]["steps"]
    (check,) = (step["run"] for step in steps if "OWNER" in step.get("run", ""))
    searched = check.partition("OWNER/meshsplatbench ")[2].split()
    assert {name for name in searched if PLACE in (ROOT / name).read_text()} == set(searched)
    assert len(searched) == 5


def test_the_image_is_built_from_files_that_exist() -> None:
    (build,) = (
        step["with"]
        for step in read_yaml(".github/workflows/release.yml")["jobs"]["image"]["steps"]
        if "context" in step.get("with", {})
    )
    assert build["context"] == "."
    assert (ROOT / build["file"]).is_file()
    assert (ROOT / f"{build['file']}.dockerignore").is_file()
    recipe = ROOT / "packaging" / "conda" / "recipe.yaml"
    assert (recipe.parent / read_yaml(str(recipe))["source"]["path"]).resolve() == ROOT.resolve()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="the steps of the action need bash")
@pytest.mark.parametrize(
    ("fail_on", "verdict", "status"),
    [("", "", 0), ("nonmanifold_edge_ratio>0\nfaces>0", "", 1), ("faces<0", "", 0), ("", "limited", 1)],
)
def test_the_action_has_the_exit_status_of_the_audit(
    fail_on: str, verdict: str, status: int, tmp_path: Path
) -> None:
    (step,) = (step for step in read_yaml("action.yml")["runs"]["steps"] if step.get("id") == "audit")
    variables = {"PATHS": "data_stubs/check*", "FAIL_ON": fail_on, "VERDICT": verdict}
    for name in ("RUNNER_TEMP", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        variables[name] = str(tmp_path if name == "RUNNER_TEMP" else tmp_path / name)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", step["run"]]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **variables, "PATH": path}, check=False)
    assert done.returncode == status
    output = (tmp_path / "GITHUB_OUTPUT").read_text()
    assert Path(output.strip().removeprefix("json=")).is_file()
    assert "BAD" in (tmp_path / "GITHUB_STEP_SUMMARY").read_text()
