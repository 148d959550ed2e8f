"""The script of the dedicated tier without a browser: which plan it draws."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

SCRIPT = """
import { Dedicated } from "./dedicated.js";
const device = {
  pushErrorScope() {}, popErrorScope: async () => null,
  createShaderModule({ code }) { if (code === "bad") throw new Error("refused"); return {}; },
};
const plan = (module) => ({ modules: { module }, passes: [], band_passes: [], arrays: {}, buffers: {} });
const modules = { good: "good", bad: "bad" }, plans = [plan("good"), plan("bad"), plan("good")];
const made = Object.assign(new Dedicated(), {
  device, about: { modules, plans, arrays: {} }, held: new Map(), compiled: new Map(), groups: new Map(),
});
const found = [];
const add = (error) => found.push([error ? error.message : null, made.number, made.wanted]);
await made.use(0);
await made.use(1).then(() => add(null), add);
const failing = made.use(1).then(() => add(null), add);
await made.use(2);
await failing;
add(null);
console.log(JSON.stringify(found));
"""


def test_after_a_plan_that_does_not_compile_the_one_that_is_drawn_is_wanted(tmp_path: Path) -> None:
    """So that `measure` has a plan to return to; one that was chosen meanwhile stays chosen."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "test.js").write_text(SCRIPT)
    for name in ("camera.js", "dedicated.js"):
        shutil.copy(ROOT / "msb/engines/web" / name, tmp_path)
    done = subprocess.run(["node", tmp_path / "test.js"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [["refused", 0, 0], ["refused", 0, 2], [None, 2, 2]]
