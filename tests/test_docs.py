"""The documentation is correct and complete.

The tests check docstring examples, links, images, names and shipped data.
"""

import doctest
import importlib
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from typer import Context
from typer.main import get_command

import msb
from data_stubs.make import splat_like_asset
from msb.cli.app import app
from msb.errors import EXIT_STATUS, AssetError, CheckpointError, MeshFileError, SceneError
from msb.metrics.registry import IMAGE_METRICS
from tests.conftest import ROOT, of_the_whole

PAGES = {path: path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md")}
README = ROOT / "README.md"
SOURCES = ("msb", "viewers", "tests", "fuzz", "docs", "tools", "benchmarks", "data_stubs")
WITH_EXAMPLES = sorted(
    path.relative_to(folder).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    for folder, package in ((ROOT, "msb"), (ROOT / "viewers", "msb_viewers"))
    for path in (folder / package).rglob("*.py")
    if ">>>" in path.read_text()
)


@pytest.mark.slow
@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_docstring_examples_give_what_they_show(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


def anchors(path: Path) -> set[str]:
    """Return the anchors of a Markdown file: headings in GitHub's form, and HTML anchors."""
    text = path.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r'<a id="([\w-]+)"', text))


@of_the_whole
def test_links_have_existing_targets() -> None:
    for path in (*ROOT.glob("*.md"), *PAGES):
        text = path.read_text(encoding="utf-8")
        for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", text):
            place = path.parent / target if target else path
            assert place.exists(), f"{path.name}: {target}"
            assert not anchor or anchor in anchors(place), f"{path.name}: {target}#{anchor}"


def test_images_are_used_and_have_descriptions() -> None:
    used = set()
    for path in (README, *PAGES):
        for text, target in re.findall(r"!\[([^\]]*)\]\(([^)\s]+)\)", path.read_text(encoding="utf-8")):
            assert len(text) > 10, f"{path.name}: {target}"
            used.add((path.parent / target).resolve())
    images = {path.resolve() for path in (ROOT / "docs" / "images").iterdir()}
    assert images - used == {(ROOT / "docs" / "images" / "icon.svg").resolve()}  # the site uses the icon


def public_names() -> set[str]:
    """Return the public names of `msb` and all names that documents import, as full names."""
    public = {f"msb.{name}" for name in msb.__all__ if name not in ("__version__", "metrics")}
    for text in (*PAGES.values(), README.read_text(encoding="utf-8")):
        for module, names in re.findall(r"^ *from (msb[\w.]*) import ([^#\n]+)$", text, re.MULTILINE):
            public |= {f"{module}.{name.strip(' ()')}" for name in names.split(",") if name.strip(" ()")}
    return public - {"msb.metrics"}


@of_the_whole
def test_the_reference_lists_all_public_names() -> None:
    listed = re.findall(r"^::: (\S+)$", PAGES[ROOT / "docs" / "api.md"], re.MULTILINE)

    def resolve(name: str) -> object:
        module_name, _, member = name.rpartition(".")
        module = importlib.import_module(module_name)
        value = getattr(module, member) if hasattr(module, member) else importlib.import_module(name)
        # Some packages, such as msb.render, are callable. Such a package stands for the function of the same
        # name.
        function = getattr(value, "__name__", "").rpartition(".")[2]
        return getattr(value, function, value) if isinstance(value, ModuleType) else value

    documented = [resolve(name) for name in listed]
    assert not [name for name in sorted(public_names()) if resolve(name) not in documented]


# The pages of docs/ that describe the options of each command.
COMMAND_PAGES = {
    "audit": ("definitions", "cli"),
    "view": ("viewer",),
    "trial": ("trial",),
    "repair": ("repair",),
    "info": ("cli",),
    "validate": ("cli",),
    "export": ("export",),
    "convert": ("meshes", "export"),
    "bake": ("bake",),
    "lod": ("lod",),
    "why": ("worse",),
    "score": ("score",),
    "methods": ("export", "cli"),
    "render": ("rendering",),
    "compare": ("viewer",),
    "web": ("engines",),
    "bench": ("rendering",),
    "scenes": ("datasets",),
    "capture": ("datasets",),
    "run": ("protocol",),
    "eval": ("metrics",),
    "submit": ("report",),
    "report": ("report",),
    "track": ("protocol",),
    "demo-data": ("cli",),
    "devices": ("cli", "opencl"),
    "completion": ("cli",),
}


def options_on(*pages: str) -> set[str]:
    """Return the options that pages of docs/ mention."""
    texts = (PAGES[ROOT / "docs" / f"{page}.md"] for page in pages)
    return set(re.findall(r"(?<![\w-])--?[a-zA-Z][\w-]*", "".join(texts)))


def find_undocumented(commands: Mapping[str, Any]) -> set[str]:
    """Return the options of commands that the documentation page of the command does not mention.

    Several commands may share an option with the same names and the same help. Such an option may be on the
    page of the command line or of rendering instead.
    """
    options = [
        (name, (*param.opts, param.help), param.opts)
        for name, command in commands.items()
        for param in command.params
        if param.param_type_name == "option"
    ]
    uses = Counter(declared for _, declared, _ in options)
    shared = options_on("cli", "rendering")
    return {
        f"msb {name} {'/'.join(flags)}"
        for name, declared, flags in options
        if (options_on(*COMMAND_PAGES[name]) | (shared if uses[declared] > 1 else set())).isdisjoint(flags)
    }


def built_in_commands() -> dict[str, Any]:
    root: Any = get_command(app)
    context = Context(root)
    return {name: root.get_command(context, name) for name in root.list_commands(context)}


@pytest.mark.slow
def test_the_page_of_a_command_mentions_its_options() -> None:
    commands = built_in_commands()
    assert not find_undocumented(commands)
    # An option of another command, such as --turntable of msb render, does not count.
    added = SimpleNamespace(opts=["--turntable"], help="Something new.", param_type_name="option")
    extended = SimpleNamespace(params=[*commands["convert"].params, added])
    assert find_undocumented({**commands, "convert": extended}) == {"msb convert --turntable"}


def test_docs_define_every_metric() -> None:
    metrics = PAGES[ROOT / "docs" / "metrics.md"]
    assert not [metric.title for metric in IMAGE_METRICS.values() if f"## {metric.title}" not in metrics]


@of_the_whole
def test_every_error_code_is_in_a_test() -> None:
    """Error codes of bad files are excluded here, because tests with such files check them."""
    words: set[str] = set()
    for path in (ROOT / "tests").rglob("*.py"):
        words.update(re.findall(r"[A-Z][A-Z0-9_]+", path.read_text(encoding="utf-8")))
    of_files = (AssetError, SceneError, MeshFileError, CheckpointError)
    assert not {code for kind in EXIT_STATUS if kind not in of_files for code in kind.codes} - words


def test_no_text_cites_a_missing_document() -> None:
    absent = re.compile(
        r"\bDESIG[N]\b|(?<!\w)\(spe[c]:|(?<!OpenCL 1.2 )(?<!OpenCL C 1.2 )\bspecificatio[n],? (section )?\d"
    )
    for path in (path for folder in SOURCES for path in (ROOT / folder).rglob("*")):
        if path.suffix in (".py", ".cl", ".md", ".toml", ".html", ".js"):
            assert not absent.search(path.read_text(encoding="utf-8")), path


def test_shipped_asset_equals_the_output_of_its_script(tmp_path: Path) -> None:
    msb.save(splat_like_asset(), tmp_path / "again.triasset")
    shipped = ROOT / "data_stubs" / "splat_like.triasset"
    assert (tmp_path / "again.triasset").read_bytes() == shipped.read_bytes()


def test_no_module_has_more_than_600_lines() -> None:
    reasons = {"msb/errors.py": "one table of all codes"}
    long = {
        path.relative_to(ROOT).as_posix()
        for folder in SOURCES
        for path in (*(ROOT / folder).rglob("*.py"), *(ROOT / folder).glob("msb_viewers/**/*.js"))
        if len(path.read_text(encoding="utf-8").splitlines()) > 600
    }
    assert long <= reasons.keys()
