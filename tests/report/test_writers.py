"""Tables are valid in each format, and names in them cannot inject markup, formulas or paths."""

import csv
import io
import json
import re

import pytest

from msb.report.safe_names import slug
from msb.report.table import Table, TableCell, TableColumn, TableRow
from msb.report.writers import (
    escape_csv,
    escape_latex,
    escape_markdown,
    to_csv,
    to_json,
    to_latex,
    to_markdown,
)
from tests.report.test_paper import paper_tables

HOSTILE = (
    "=cmd|' /C calc'!A0 <script>alert(1)</script> \\input{x} $x$ |y| [a](http://e.xy) %&_#^~{}"
    "\x1b[31m\n\u202e"
)


def hostile_table() -> Table:
    cell = TableCell("1.00", 1.0, "psnr", "dB", bold=True, notes=(HOSTILE,))
    columns = (TableColumn(HOSTILE, (HOSTILE,)), TableColumn("b"))
    return Table(
        "x", HOSTILE, ("Scene",), columns, (TableRow((HOSTILE,), (cell, TableCell("N/A"))),), (HOSTILE,)
    )


def tables() -> list[Table]:
    return [*paper_tables().values(), hostile_table()]


@pytest.mark.parametrize("table", tables(), ids=lambda t: t.label)
def test_markdown_has_the_same_number_of_cells_in_every_line(table: Table) -> None:
    lines = [line for line in to_markdown(table).splitlines() if line.startswith("|")]
    counts = {len(re.findall(r"(?<!\\)\|", line)) for line in lines}
    assert counts == {len(table.heads) + len(table.columns) + 1}


@pytest.mark.parametrize("table", tables(), ids=lambda t: t.label)
def test_latex_is_balanced_and_every_row_has_all_columns(table: Table) -> None:
    text = to_latex(table)
    plain = re.sub(r"\\[\\{}$&#%_]", "", text)
    assert plain.count("{") == plain.count("}")
    assert len(re.findall(r"\$", plain)) % 2 == 0
    assert re.findall(r"\\begin\{(\w+\*?)\}", text) == re.findall(r"\\end\{(\w+\*?)\}", text)[::-1]
    body = text.split(r"\toprule")[1].split(r"\bottomrule")[0]
    width = len(re.findall("[lc]", text.split("{tabular}")[1].split("\n")[0]))
    for line in body.splitlines():
        if not line.endswith(r"\\") or rf"\multicolumn{{{width}}}" in line:
            continue
        spans = sum(int(span) - 1 for span in re.findall(r"\\multicolumn\{(\d+)\}", line))
        assert len(re.findall(r"(?<!\\)&", line)) + spans == width - 1, line
    assert not re.search(r"(?<!\\)[%#]", body)
    assert r"\input" not in text
    assert "\x1b" not in text


@pytest.mark.parametrize("table", tables(), ids=lambda t: t.label)
def test_csv_can_be_read_again_and_holds_no_formula(table: Table) -> None:
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert len({len(row) for row in rows}) == 1
    assert len(rows) == len(table.rows) + 1
    for cell in (cell for row in rows for cell in row):
        assert not cell.startswith(("=", "@", "\t", "\r"))
        assert not cell.startswith(("+", "-")) or re.fullmatch(r"--|[+-][\d.]+( \(\d+/\d+\))?", cell)
    printed = [cell.text for row in table.rows for cell in row.cells]
    assert [cell for row in rows[1:] for cell in row[-len(table.columns) - 1 : -1]] == printed


@pytest.mark.parametrize("table", tables(), ids=lambda t: t.label)
def test_json_is_the_table(table: Table) -> None:
    data = json.loads(to_json(table), parse_constant=lambda name: pytest.fail(name))
    assert data == json.loads(json.dumps(table.to_dict()))
    assert [len(row["cells"]) for row in data["rows"]] == [len(table.columns)] * len(table.rows)


def test_markdown_escapes_markup() -> None:
    text = to_markdown(hostile_table())
    assert not re.search(r"(?<!\\)<script|(?<!\\)\]\(", text)
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert escape_markdown("a|b*c_") == r"a\|b\*c\_"


@pytest.mark.parametrize(
    ("text", "safe"),
    [("=1+1", "'=1+1"), ("@SUM(A1)", "'@SUM(A1)"), ("-cmd", "'-cmd"), ("+0.79", "+0.79"), ("--", "--"),
     ("0.30 (7/9)", "0.30 (7/9)"),
     ("+0.30 (7/9)", "'+0.30 (7/9)"), ("-0.30 (7/9)", "'-0.30 (7/9)"), ("\t=1", "'=1"), ("plain", "plain")],
)  # fmt: skip
def test_csv_quotes_formulas_only(text: str, safe: str) -> None:
    assert escape_csv(text) == safe


def test_latex_prints_names_unchanged() -> None:
    assert escape_latex(r"a_b & 50 % \x") == r"a\_b \& 50 \% \textbackslash{}x"
    assert escape_latex("x--y---z") == "x-{}-y-{}-{}-z"


def test_slugs_are_plain_and_do_not_collide() -> None:
    names = [
        "garden",
        "scan24",
        "../../etc/passwd",
        "a b",
        "a_b",
        "a/b",
        "ä",
        "",
        "...",
        "x" * 300,
        "x" * 301,
    ]
    slugs = [slug(name) for name in names]
    assert slugs[:2] == ["garden", "scan24"]
    assert len(set(slugs)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,80}", name) for name in slugs)


def test_latex_omits_columns_without_values_with_a_note() -> None:
    columns = tuple(
        TableColumn(title, (method,)) for method in ("A", "B") for title in ("PSNR", "LPIPS", "FPS")
    )
    absent = TableCell("--", reason="LPIPS: no weights")
    cells = [(TableCell("1.0"), absent, TableCell("9"), TableCell("2.0"), absent, TableCell("--"))] * 2
    rows = tuple(TableRow((name,), row_cells) for name, row_cells in zip(("x", "y"), cells, strict=True))
    table = Table("t", "Caption", ("Scene",), columns, rows)
    text = to_latex(table)
    assert r"\begin{tabular}{@{}lccc@{}}" in text
    assert r"x & 1.0 & 9 & 2.0 \\" in text
    assert "LPIPS, B FPS (LPIPS: no weights)" in text
    assert "LPIPS" in to_markdown(table).splitlines()[2], "other formats keep all columns"
