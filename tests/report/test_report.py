"""Complete reports and the command `msb report`: files, pages, charts, and unusual results."""

import json
import os
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from msb.bench.documents import AuditDocument
from msb.bench.records import Cell, File, read_result
from msb.report.build import build_report, paper_report
from msb.report.figures import make_sheet, plot_deployment_gap, plot_differences
from msb.report.numbers import MEAN, Key, Number, Numbers
from msb.report.pages import report_files
from msb.report.report import Report
from msb.report.results import LoadedResult, Place, read_results, result_set
from msb.report.tables.reproducibility import pair_with_published
from tests.cli.conftest import Msb
from tests.report.factory import (
    AUDIT,
    make_result,
    measure,
    write,
    write_results,
)
from tests.report.test_writers import HOSTILE
from tests.robustness.conftest import Bound, bound

__all__ = ["bound"]


class Page(HTMLParser):
    """The tags and texts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def values(self, *names: str) -> list[str]:
        return [str(value) for _, attrs in self.tags for name, value in attrs.items() if name in names]


@pytest.fixture(scope="module")
def files(report: Report, small: Path) -> dict[str, bytes]:
    return report_files(report, folder=small / "report")


@pytest.mark.slow
def test_views_with_the_largest_loss_and_chosen_views_are_included(small: Path) -> None:
    report = build_report(read_results(small), chosen=["truck/a/0002.png"])
    (section,) = [section for section in report.sections if section.name == "looks"]
    titles = [view.title for view in section.views]
    assert "12.30 dB (Triangle-Splatting)" in titles[0]
    assert any("truck, a/0002.png" in title for title in titles)
    view = section.views[0]
    assert list(view.renderings) == ["two_dts", "triangle_splatting", "mesh_splatting", "diffsoup"]
    headings = [[rendering.heading for rendering in row] for row in view.renderings.values()]
    assert headings == [["Non-Engine", "Dedicated", "Standard"]] * 3 + [["Non-Engine", "Dedicated"]]
    image = view.renderings["two_dts"][2].image
    assert image.data[:3] == b"\xff\xd8\xff"


def test_a_report_has_all_files(files: dict[str, bytes], report: Report) -> None:
    expected = {
        f"tables/{label}.{suffix}" for label in report.tables for suffix in ("md", "tex", "csv", "json")
    }
    expected |= {"report.md", "report.json", "index.html"}
    expected |= {f"verdict-tanksandtemples-{scene}-{method}.html" for scene in ("train", "truck")
                 for method in ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")}  # fmt: skip
    others = set(files) - expected
    assert expected <= set(files)
    assert all(name.startswith(("figures/", "images/")) for name in others)
    data = json.loads(files["report.json"])
    assert data["schema"] == "msb.report/1"
    assert [table["label"] for table in data["tables"]] == list(report.tables)
    assert len(data["verdicts"]) == 8
    assert {finding.table for finding in report.findings} <= set(report.tables)


def test_markdown_links_to_existing_files(files: dict[str, bytes]) -> None:
    targets = re.findall(r"\]\(([^)]+)\)", files["report.md"].decode())
    assert len(targets) > 10
    assert set(targets) <= set(files)


def test_pages_work_offline_and_link_to_existing_files(files: dict[str, bytes]) -> None:
    for name in (name for name in files if name.endswith(".html")):
        text = files[name].decode()
        page = Page(text)
        assert "default-src 'none'" in page.values("content")[0]
        assert all(value.startswith("data:") for value in page.values("src"))
        anchors = set(page.values("id"))
        assert len(anchors) == len(page.values("id"))
        for link in page.values("href"):
            assert link[1:] in anchors if link.startswith("#") else link in files, (name, link)
        assert not [tag for tag, _ in page.tags if tag in ("link", "iframe", "object", "base", "form")]
        # XML namespaces are never fetched.
        urls = set(re.findall(r"https?://[^\s\"'<]+", text))
        assert all(
            url.startswith(("http://www.w3.org/", "http://purl.org/", "http://creativecommons.org/"))
            for url in urls
        )
        assert "url(http" not in text


@pytest.mark.slow
def test_without_the_paper_its_numbers_are_left_out(small: Path, report: Report) -> None:
    results = read_results(small)
    without = build_report(results, with_paper=False)
    assert report.mixes
    assert not without.mixes
    assert set(report.tables) - set(without.tables) == {"reproducibility", "reproducibility_statistics"}
    figures = [figure.name for section in without.sections for figure in section.figures]
    assert not [name for name in figures if "reprod" in name]
    files = report_files(without)
    for name in (name for name in files if name.endswith((".html", ".md", ".csv", ".tex"))):
        text = files[name].decode()
        assert "in the paper" not in text, name
        assert 'class="paper"' not in text, name
    key = Key("tanksandtemples", MEAN, "two_dts", "non_engine", "psnr", "public")
    with_public = build_report(results, published={key: Number(23.0)}, pictures=False, with_paper=False)
    heads = {column.groups for column in with_public.tables["reproducibility"].columns}
    assert heads == {("Public",), ("This run",)}


def test_index_shows_every_table_with_its_numbers(files: dict[str, bytes], report: Report) -> None:
    page = Page(files["index.html"].decode())
    words = set(page.words)
    for table in report.tables.values():
        assert table.label in page.values("id")
        assert {cell.text for row in table.rows for cell in row.cells} <= words


def test_verdict_page_has_renderings_and_the_diagnostic_or_its_command(report: Report, small: Path) -> None:
    place = Place("tanksandtemples", "train", "mesh_splatting")
    name = "verdict-tanksandtemples-train-mesh_splatting.html"
    without = Page(report_files(report, formats=["html"])[name].decode())
    assert [attrs["alt"] for tag, attrs in without.tags if tag == "img"][:4] == [
        "Ground truth",
        "Non-Engine",
        "Dedicated",
        "Standard",
    ]
    command = "msb view --figure topology.png x.triasset"
    assert command in without.words
    png = b"\x89PNG drawn elsewhere"
    with_ = Page(report_files(report, formats=["html"], topology={place: png})[name].decode())
    assert any(str(value).startswith("data:image/png") for value in with_.values("src"))
    assert command not in with_.words


@pytest.mark.slow
def test_films_are_embedded_if_small_and_linked_if_not(report: Report, small: Path, monkeypatch: Any) -> None:
    path = small / "videos" / "tanksandtemples" / "train" / "two_dts.mp4"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"film")
    name = "verdict-tanksandtemples-train-two_dts.html"
    text = report_files(report, formats=["html"], folder=small / "report")[name].decode()
    assert 'src="data:video/mp4;base64,ZmlsbQ=="' in text
    monkeypatch.setattr("msb.report.pages.MAX_EMBEDDED_FILM", 2)
    text = report_files(report, formats=["html"], folder=small / "report")[name].decode()
    assert 'href="../videos/tanksandtemples/train/two_dts.mp4"' in text
    path.unlink()


def test_one_failed_record_makes_a_report(tmp_path: Path) -> None:
    from msb.bench.records import Reason, Result

    cell = Cell(dataset="capture", scene="desk", method="two_dts", condition="dedicated")
    reason = Reason(code="OPENCL_BUILD", message="no device")
    write(tmp_path, Result(cell=cell, status="failed", reason=reason, seconds=0.1))
    report = build_report(read_results(tmp_path))
    (note,) = report.notes
    assert "OPENCL_BUILD: no device" in note
    text = report_files(report)["index.html"].decode()
    assert "OPENCL_BUILD: no device" in text
    assert report.findings == ()


@pytest.mark.slow
def test_hostile_names_are_escaped(tmp_path: Path) -> None:
    scene = '<img src=x onerror="alert(1)">'
    results = []
    for condition in ("non_engine", "dedicated", "exported_mesh"):
        record = make_result("x", "y", "z", condition)
        cell = Cell(
            dataset=HOSTILE[:150], scene=scene, method="</script>" + HOSTILE[:100], condition=condition
        )
        bad = {"level": "bad", "sentence": "<b>renders</b>"}
        changes: dict[str, Any] = {"cell": cell}
        if record.audit is not None:
            changes["audit"] = AuditDocument.of({**AUDIT, "verdict": bad})
        # The folders have plain names, because the names of the methods are not valid names of folders.
        path = write(tmp_path, make_result("x", "y", "z", condition))
        path.write_bytes(record.model_copy(update=changes).to_json())
        results.append(LoadedResult(read_result(path), path, tmp_path))
    files = report_files(build_report(result_set(results)))
    assert all(re.fullmatch(r"((tables|figures|images)/)?[A-Za-z0-9_.-]+", name) for name in files)
    plain = Page(report_files(paper_report(), formats=["html"])["index.html"].decode())
    scripts = sum(tag == "script" for tag, _ in plain.tags)
    for name in (name for name in files if name.endswith(".html")):
        page = Page(files[name].decode())
        assert sum(tag == "script" for tag, _ in page.tags) == scripts
        assert not [
            1 for tag, attrs in page.tags if "onerror" in attrs or (tag == "img" and attrs.get("src") == "x")
        ]
        assert not [tag for tag, _ in page.tags if tag == "b" and "renders" in page.words]
    for name in (name for name in files if name.endswith(".svg")):
        ET.fromstring(files[name])


def test_other_scenes_of_a_dataset_are_not_compared_with_published_numbers(tmp_path: Path) -> None:
    for scene in ("attic", "cellar"):
        write(tmp_path, make_result("mipnerf360", scene, "two_dts", "non_engine"))
    report = build_report(read_results(tmp_path))
    table = report.tables["renderer_comparison-mipnerf360"]
    assert not any(row.paper for row in table.rows)
    assert "reproducibility" not in report.tables
    value = report.numbers.value(Key("mipnerf360", MEAN, "two_dts", "non_engine", "psnr"))
    assert table.rows[0].cells[0].text == f"{value:.2f}"
    assert report.notes[0].startswith("Mip-NeRF 360: ")


@pytest.mark.slow
def test_six_methods_fit_a_page_and_wider_tables_have_a_shadow(
    tmp_path: Path, in_browser: Callable[..., Any]
) -> None:
    for number in range(6):
        for condition in ("non_engine", "dedicated", "standard", "exported_mesh"):
            record = make_result("tanksandtemples", "train", "two_dts", condition)
            cell = record.cell.model_copy(update={"label": f"two_dts_{number}"})
            write(tmp_path, record.model_copy(update={"cell": cell}))
    page = report_files(build_report(read_results(tmp_path), pictures=False), formats=["html"])["index.html"]
    script = """return [...document.querySelectorAll(".scroll")].map((table) => [table.ariaLabel,
      table.scrollWidth > table.clientWidth,
      getComputedStyle(table).backgroundImage.includes("gradient")])"""
    regions = in_browser(page, script, size=(1280, 900))
    assert regions[0] == ["Assets", False, True]
    assert any(is_cut for _, is_cut, _ in regions)
    assert all(has_shadow for _, _, has_shadow in regions)


@pytest.mark.slow
def test_charts_are_well_formed_and_use_the_colours_of_the_page(report: Report) -> None:
    charts = [figure for section in report.sections for figure in section.figures]
    names = {figure.name for figure in charts}
    assert {"deployment_gap-tanksandtemples", "quality_speed-tanksandtemples"} <= names
    assert "reproducibility-tanksandtemples" in names
    identifiers: list[str] = []
    for figure in charts:
        root = ET.fromstring(figure.standalone)
        identifiers += [value for node in root.iter() if (value := node.get("id"))]
        assert "currentColor" in figure.inline
        assert "#010203" not in figure.inline + figure.standalone
        assert "<script" not in figure.svg
    assert len(identifiers) == len(set(identifiers))


@pytest.mark.slow
def test_equal_charts_are_equal_bytes(numbers: Numbers) -> None:
    first, second = (plot_deployment_gap(numbers, "mipnerf360") for _ in range(2))
    assert first == second
    assert first.pdf() == second.pdf()


def test_models_of_a_protocol_have_different_line_styles() -> None:
    # These two names have the same letters. A sum over letters would not distinguish them.
    models = ["two_dts", "ab", "ba", *(f"model {number}" for number in range(6))]
    conditions = ("non_engine", "dedicated", "dedicated/global", "dedicated/none")
    values = {
        Key("mine", scene, model, condition, "psnr"): Number(20.0)
        for scene in ("pebble", "mean")
        for model in models
        for condition in conditions
    }
    figure = plot_deployment_gap(Numbers(values), "mine")
    drawn = re.findall(r'<path d="[^"]*" clip-path="[^"]*" style="([^"]*)"', figure.svg)
    styles = {style for style in drawn if re.search(r"stroke-width: 1\.8\b", style)}
    assert len(styles) == len(models)
    assert [figure.svg.count(f">ab{variant}<") for variant in ("", ", global", ", none")] == [1, 1, 1]
    ticks = [float(y) for y in re.findall(r'text-anchor: end[^>]* y="([0-9.]+)"', figure.svg)]
    assert max(ticks) - min(ticks) > 72, "in points: the chart keeps its height with 27 names in the legend"


@pytest.mark.slow
def test_latex_charts_are_pdf_without_dates_and_type_3_fonts(report: Report) -> None:
    files = report_files(report, formats=["tex"])
    charts = [name for name in files if name.startswith("figures/")]
    figures = [figure for section in report.sections for figure in section.figures]
    sheets = [make_sheet(view) for section in report.sections for view in section.views]
    assert set(charts) == {f"figures/{figure.name}.pdf" for figure in (*figures, *sheets)}
    for name in charts:
        assert files[name].startswith(b"%PDF-")
        assert not re.search(rb"/(CreationDate|Producer|Creator|Type3)\b", files[name])
        assert b"/TrueType" in files[name] or b"/CIDFontType2" in files[name]


@pytest.mark.slow
def test_a_sheet_shows_the_photograph_and_every_condition_of_each_method(tmp_path: Path) -> None:
    for method in ("two_dts", "diffsoup"):
        for condition, psnr in (("non_engine", 30.0), ("dedicated", 28.0), ("standard", 20.0)):
            if (method, condition) != ("diffsoup", "standard"):  # which it does not support
                measure(tmp_path, condition, psnr, images=True, method=method)
    report = build_report(read_results(tmp_path), with_paper=False)
    (view, *_) = [view for section in report.sections for view in section.views]
    svg = make_sheet(view).svg
    assert svg.count("<image") == 2 * 3 + 2 - 1  # a photograph and three conditions each, one of them missing
    assert ">N/A<" in svg
    for text in ("Ground truth", "Non-Engine", "Standard", "2DTS", "DiffSoup"):
        assert f">{text}<" in svg
    files = report_files(report, formats=["tex"], topology={Place("capture", "desk", "two_dts"): b"png"})
    assert files["figures/topology-capture-desk-two_dts.png"] == b"png"
    assert any(name.startswith("figures/qualitative-capture-desk-") for name in files)


def test_a_dataset_with_means_only_does_not_count_as_other_scenes() -> None:
    means = Numbers({Key("dtu", "mean", "two_dts", "non_engine", "psnr"): Number(20.0)})
    assert not means.has_other_scenes("dtu")


@pytest.mark.slow
def test_published_scenes_give_bars_per_scene(numbers: Numbers) -> None:
    scene = Key("tanksandtemples", "train", "two_dts", "non_engine", "psnr", "paper")
    pairs = pair_with_published(numbers, Numbers({scene: Number(23.0)}))
    figure = plot_differences(pairs, "tanksandtemples")
    assert "per scene" in figure.caption
    assert ">train<" in figure.svg
    assert plot_differences(pairs, "dtu") is None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_results(tmp_path_factory.mktemp("run"), datasets=["tanksandtemples"], images=True)


@pytest.mark.slow
def test_a_report_replaces_its_own_files_only(msb: Msb, folder: Path) -> None:
    done = msb("report", folder, status=0)
    assert done.out.startswith("32 results ")
    assert done.out.splitlines()[-1] == str(folder / "report" / "index.html")
    assert (folder / "report" / "tables" / "native_summary.tex").is_file()
    assert (folder / "report" / "verdict-tanksandtemples-train-two_dts.html").is_file()
    data = msb("report", "--format", "tex", "--json", "-", folder, status=0).json
    assert (data["schema"], len(data["verdicts"])) == ("msb.report/1", 8)
    assert "tables/native_summary.tex" in data["files"]
    assert not (folder / "report" / "index.html").exists()
    (folder / "report" / "mine.txt").write_text("a page of notes")
    msb("report", "-f", "-q", "--format", "csv", folder, status=0)
    assert (folder / "report" / "mine.txt").exists()
    msb("report", "-f", "-o", folder, folder).ends(2, "USAGE: ")
    msb("report", "-f", "-o", folder.parent, folder).ends(2, "OUTPUT_EXISTS: ")


@pytest.mark.slow
def test_results_of_another_user_are_reported_elsewhere(bound: Bound, small: Path, tmp_path: Path) -> None:
    root = shutil.copytree(small, tmp_path / "theirs")
    for path in (root, *root.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
        if os.geteuid() == 0:
            os.chown(path, 65534, 65534)
    status, _, err = bound("-m", "msb", "report", "--format", "csv", root)
    assert (status, err.startswith(f"OUTPUT_UNWRITABLE: {root / 'report'}: ")) == (3, True)
    status, _, err = bound("-m", "msb", "report", "--format", "csv", root, "-o", tmp_path / "mine")
    assert (status, err) == (0, "")
    assert not (root / "report").exists()


@pytest.mark.slow
def test_one_table_is_printed(msb: Msb, folder: Path) -> None:
    done = msb("report", "--table", "renderer_comparison-tanksandtemples", folder, status=0)
    assert done.out.startswith("**Tanks and Temples: ")
    assert re.search(r"^\| Standard \| .*PSNR ↑ \|", done.out, re.MULTILINE)
    data = msb("report", "--table", "slowdown", "--json", "-", folder).json
    assert data["schema"] == "msb.table/1"
    as_csv = msb("report", "--table", "slowdown", "--format", "csv", folder).out
    assert as_csv.splitlines()[0].endswith(",Source")
    # so that the output can be redirected to a file
    assert as_csv.count("\n") == as_csv.rstrip().count("\n") + 1
    for formats in ("tex,csv", "html"):
        assert msb("report", "--table", "slowdown", "--format", formats, folder).err.startswith("USAGE: ")
    msb("report --table nonsense", folder).ends(2, "NAME_UNKNOWN: ")
    msb("report", "--table", "slowdown", "--view", "train/none.png", folder).ends(2, "USAGE: ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["--paper", "x"], "USAGE"),
        (["--paper", "--published", "nothere.json"], "USAGE"),
        (["--paper", "--view", "garden/a.png"], "USAGE"),
        (["--paper", "--against", "diffsoup"], "USAGE"),
        (["--paper", "--no-paper"], "USAGE"),
        ([], "USAGE"),
        (["--format", "pdf", "--paper"], "USAGE"),
        (["nowhere"], "FILE_NOT_FOUND"),
        (["README.md"], "FILE_UNREADABLE"),
        (["docs"], "RESULTS_EMPTY"),
    ],
)
def test_invalid_uses_give_one_line(msb: Msb, args: list[str], code: str) -> None:
    msb("report", *args).ends(2 if "USAGE" in code else 3, code)


@pytest.mark.slow
def test_mesh_diagnostics_show_the_audited_asset(msb: Msb, demo_asset: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="extra view is not installed")
    import msb as library

    about = File(path=str(demo_asset), bytes=demo_asset.stat().st_size)
    audit = library.audit(library.load(demo_asset)).to_dict()
    assert audit["verdict"]["level"] == "bad"
    record = make_result("capture", "desk", "mesh_splatting", "exported_mesh", asset=about)
    write(tmp_path, record, audit=audit)
    done = msb("report", "--format", "html", tmp_path, status=0)
    if "VIEW_NO_DISPLAY" in done.err:
        pytest.skip("there is no display for drawing")
    page = (tmp_path / "report" / "verdict-capture-desk-mesh_splatting.html").read_text()
    assert "data:image/png;base64," in page
    assert audit["verdict"]["sentence"][1:40] in page
    audit["counts"]["faces"] += 1
    write(tmp_path, record, audit=audit)
    done = msb("report", "-f", "--format", "html", tmp_path, status=0)
    assert done.err.count("\n") == 1
    page = (tmp_path / "report" / "verdict-capture-desk-mesh_splatting.html").read_text()
    assert "data:image/png;base64," not in page


@pytest.mark.slow
def test_sorting_works_in_a_browser(report: Report, in_browser: Callable[..., Any]) -> None:
    page = report_files(report, formats=["html"])["index.html"]
    # Press the first button of the summary twice.
    press = """
    const table = document.querySelector('#native_summary table'), rows = () =>
      [...table.querySelectorAll('tbody tr:not(.group):not(.paper)')]
        .map((row) => row.cells[1].dataset.value);
    const button = table.querySelector('thead button'); button.click(); const down = rows(); button.click();
    const pairs = [...table.querySelectorAll('tr.paper')].every((row) =>
      !row.previousElementSibling.classList.contains('paper'));
    return [down, rows(), pairs];
    """
    down, up, pairs = in_browser(page, press)
    values = list(map(float, down))
    assert len(values) == 4
    assert values == sorted(values, reverse=True)
    assert up == down[::-1]
    assert pairs
