"""One table in every format: Markdown, LaTeX, CSV, JSON.

Names in a record can come from anywhere, so each format escapes what it would otherwise obey.
"""

import csv
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from typing import Literal

from msb.errors import formula_safe
from msb.report.safe_names import plain_text
from msb.report.table import NOT_THERE, Cell, Table

Printed = Literal["md", "tex", "csv", "json"]
Format = Printed | Literal["html"]

# A bracket after ``\\`` would be its argument.
_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "[": "{[}",
    "]": "{]}",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
}


def markdown(table: Table) -> str:
    """Return the table as GitHub's Markdown: headings on one line, the caption above, footnotes below."""
    marks = table.footnotes()
    heads = [markdown_text(head) for head in table.heads]
    heads += [markdown_text(column.name) for column in table.columns]
    aligned = "|" + "---|" * len(table.heads) + "---:|" * len(table.columns)
    lines = [f"**{markdown_text(table.caption)}**", "", _markdown_line(heads), aligned]
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            lines.append(_markdown_line([f"*{markdown_text(row.section)}*"] + [""] * (len(heads) - 1)))
        section = row.section
        labels = [markdown_text(label) for label in row.labels]
        labels[-1] = f"**{labels[-1]}**" if row.strong else f"*{labels[-1]}*" if row.paper else labels[-1]
        lines.append(_markdown_line([*labels, *(_markdown_cell(cell, marks) for cell in row.cells)]))
    notes = [f"- {markdown_text(note)}" for note in table.notes]
    notes += [f"- <sup>{mark}</sup> {markdown_text(note)}" for note, mark in marks.items()]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def latex(table: Table) -> str:
    r"""Return the table as a LaTeX float; needs booktabs and graphicx, and UTF-8.

    A table too wide for the page is made to fit. Columns without a value are left out, and a note names them.
    ``\label{tab:LABEL}`` names the table.
    """
    table = _without_empty_columns(table)
    marks = table.footnotes()
    count = len(table.heads)
    lines = [
        r"% needs \usepackage{booktabs} and \usepackage{graphicx}",
        r"\begin{table*}[tbp]",
        r"\centering",
        r"\small",
        r"\resizebox{\ifdim\width>\textwidth\textwidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{@{{}}{'l' * count}{'c' * len(table.columns)}@{{}}}}",
        r"\toprule",
        *_latex_headings(table),
        r"\midrule",
        *_latex_rows(table, marks),
        r"\bottomrule",
        r"\end{tabular}}",
    ]
    notes = [latex_text(note) for note in table.notes]
    notes += [rf"\textsuperscript{{{mark}}} {latex_text(note)}" for note, mark in marks.items()]
    lines += [rf"\par\smallskip{{\footnotesize {'; '.join(notes)}.\par}}"] if notes else []
    lines += [rf"\caption{{{latex_text(table.caption)}}}", rf"\label{{tab:{table.label}}}", r"\end{table*}"]
    return "\n".join(lines) + "\n"


def csv_table(table: Table) -> str:
    """Return the table as CSV with printed values; each row says "ours" or "paper"."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    heads = [*table.heads, *(column.name for column in table.columns)]
    sections = any(row.section for row in table.rows)
    writer.writerow(map(csv_text, [*(["Section"] if sections else []), *heads, "Source"]))
    for row in table.rows:
        start = [row.section, *row.labels] if sections else list(row.labels)
        cells = [*start, *(cell.text for cell in row.cells), "paper" if row.paper else "ours"]
        writer.writerow(map(csv_text, cells))
    return file.getvalue()


def json_table(table: Table) -> str:
    """Return the table as JSON (schema msb.table/1)."""
    return json.dumps(table.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


# Suffix -> writer of one table.
WRITERS: dict[Printed, Callable[[Table], str]] = {
    "md": markdown,
    "tex": latex,
    "csv": csv_table,
    "json": json_table,
}


def markdown_text(text: str) -> str:
    """Return `text` escaped, so that Markdown shows it unchanged."""
    return re.sub(r"([\\`*_\[\]<>|#~&$])", r"\\\1", plain_text(text))


def latex_text(text: str) -> str:
    """Return `text` escaped, so that LaTeX sets it unchanged."""
    escaped = "".join(_LATEX.get(letter, letter) for letter in plain_text(text))
    return escaped.replace("--", "-{}-").replace("--", "-{}-")  # two hyphens would be a dash


def csv_text(text: str) -> str:
    """Return `text` so that no spreadsheet takes it for a formula; numbers and "--" stay."""
    return formula_safe(plain_text(text).strip())


def _markdown_line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _markdown_cell(cell: Cell, marks: dict[str, str]) -> str:
    text = markdown_text(cell.text)
    text = f"**{text}**" if cell.bold else text
    footnotes = ",".join(marks[note] for note in cell.footnotes)
    return f"{text}<sup>{footnotes}</sup>" if footnotes else text


def _without_empty_columns(table: Table) -> Table:
    """Return the table without the columns of which every cell is --, with a note that says why they are."""
    cells = [[row.cells[number] for row in table.rows] for number in range(len(table.columns))]
    kept = [number for number, own in enumerate(cells) if any(cell.text != NOT_THERE for cell in own)]
    if not kept or len(kept) == len(cells):
        return table
    titles = {table.columns[number].title for number in kept}
    left = [number for number in range(len(cells)) if number not in kept]
    names = dict.fromkeys(
        column.name if column.title in titles else column.title
        for column in (table.columns[number] for number in left)
    )
    why = dict.fromkeys(note for number in left for cell in cells[number] for note in cell.footnotes)
    reasons = f" ({'; '.join(why)})" if why else ""
    return replace(
        table,
        columns=tuple(table.columns[number] for number in kept),
        rows=tuple(replace(row, cells=tuple(row.cells[n] for n in kept)) for row in table.rows),
        notes=(*table.notes, f"left out, because no cell has a value: {', '.join(names)}{reasons}"),
    )


def _latex_headings(table: Table) -> list[str]:
    lines = []
    first = len(table.heads) + 1
    for level in range(table.depth):
        cells, rules, at = [""] * len(table.heads), [], first
        for heading, span in table.spans(level):
            text = rf"\textbf{{{latex_text(heading)}}}" if heading else ""
            cells.append(rf"\multicolumn{{{span}}}{{c}}{{{text}}}")
            rules += [rf"\cmidrule(lr){{{at}-{at + span - 1}}}"] if heading else []
            at += span
        lines += [" & ".join(cells) + r" \\", "".join(rules)]
    titles = [rf"\textbf{{{latex_text(head)}}}" for head in table.heads]
    titles += [latex_text(column.title) for column in table.columns]
    return [*lines, " & ".join(titles) + r" \\"]


def _latex_rows(table: Table, marks: dict[str, str]) -> list[str]:
    lines: list[str] = []
    width = len(table.heads) + len(table.columns)
    section = ""
    for (heading, above), rows in groupby(table.rows, lambda row: (row.section, row.labels[:-1])):
        lines += [r"\midrule"] if lines else []
        if heading and heading != section:
            title = rf"\multicolumn{{{width}}}{{c}}{{\textit{{{latex_text(heading)}}}}} \\"
            lines += [title, r"\midrule"]
        section = heading
        first = [latex_text(label) for label in above]
        for row in rows:
            last = latex_text(row.labels[-1])
            last = rf"\textbf{{{last}}}" if row.strong else rf"\emph{{{last}}}" if row.paper else last
            cells = (_latex_cell(cell, marks) for cell in row.cells)
            lines.append(" & ".join([*first, last, *cells]) + r" \\")
            first = [""] * len(above)
    return lines


def _latex_cell(cell: Cell, marks: dict[str, str]) -> str:
    # Written as the paper writes them: a dash for what is not there, small capitals for what cannot be.
    text = {"--": "--", "N/A": r"\textsc{N/A}"}.get(cell.text) or latex_text(cell.text)
    text = rf"\textbf{{{text}}}" if cell.bold else text
    footnotes = ",".join(marks[note] for note in cell.footnotes)
    return rf"{text}\textsuperscript{{{footnotes}}}" if footnotes else text
