"""Write one table as Markdown, LaTeX, CSV or JSON.

Names in result files can contain any character, so each writer escapes the special characters of its format.
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
from msb.report.table import NOT_AVAILABLE, Table, TableCell

# Formats of single tables, and formats of a report.
TableFormat = Literal["md", "tex", "csv", "json"]
ReportFormat = TableFormat | Literal["html"]

# For each special character, the LaTeX code that prints it. Escape brackets, because LaTeX reads a bracket
# after ``\\`` as an argument.
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


def to_markdown(table: Table) -> str:
    """Return the table as GitHub Markdown: caption, one line of headings, rows, notes."""
    marks = table.footnotes()
    heads = [escape_markdown(head) for head in table.heads]
    heads += [escape_markdown(column.full_title) for column in table.columns]
    aligned = "|" + "---|" * len(table.heads) + "---:|" * len(table.columns)
    lines = [f"**{escape_markdown(table.caption)}**", "", _markdown_line(heads), aligned]
    section = ""
    for row in table.rows:
        # Each section heading is printed as a separate row.
        if row.section and row.section != section:
            lines.append(_markdown_line([f"*{escape_markdown(row.section)}*"] + [""] * (len(heads) - 1)))
        section = row.section
        labels = [escape_markdown(label) for label in row.labels]
        labels[-1] = f"**{labels[-1]}**" if row.strong else f"*{labels[-1]}*" if row.paper else labels[-1]
        lines.append(_markdown_line([*labels, *(_markdown_cell(cell, marks) for cell in row.cells)]))
    notes = [f"- {escape_markdown(note)}" for note in table.notes]
    notes += [f"- <sup>{mark}</sup> {escape_markdown(note)}" for note, mark in marks.items()]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def to_latex(table: Table) -> str:
    r"""Return the table as a LaTeX float with the label ``tab:LABEL``. The LaTeX document must load booktabs
    and graphicx.

    A table that is too wide is scaled to the page. Columns without any value are omitted and listed in a
    note.
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
    notes = [escape_latex(note) for note in table.notes]
    notes += [rf"\textsuperscript{{{mark}}} {escape_latex(note)}" for note, mark in marks.items()]
    lines += [rf"\par\smallskip{{\footnotesize {'; '.join(notes)}.\par}}"] if notes else []
    lines += [rf"\caption{{{escape_latex(table.caption)}}}"]
    lines += [rf"\label{{tab:{table.label}}}", r"\end{table*}"]
    return "\n".join(lines) + "\n"


def to_csv(table: Table) -> str:
    """Return the table as CSV with printed values. The last column, Source, contains "ours" or "paper"."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    heads = [*table.heads, *(column.full_title for column in table.columns)]
    sections = any(row.section for row in table.rows)
    writer.writerow(map(escape_csv, [*(["Section"] if sections else []), *heads, "Source"]))
    for row in table.rows:
        labels = [row.section, *row.labels] if sections else list(row.labels)
        cells = [*labels, *(cell.text for cell in row.cells), "paper" if row.paper else "ours"]
        writer.writerow(map(escape_csv, cells))
    return file.getvalue()


def to_json(table: Table) -> str:
    """Return the table as JSON (schema msb.table/1)."""
    return json.dumps(table.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


# For each file extension, the function that writes a table.
WRITERS: dict[TableFormat, Callable[[Table], str]] = {
    "md": to_markdown,
    "tex": to_latex,
    "csv": to_csv,
    "json": to_json,
}


def escape_markdown(text: str) -> str:
    """Return `text` escaped, so that Markdown prints it unchanged."""
    return re.sub(r"([\\`*_\[\]<>|#~&$])", r"\\\1", plain_text(text))


def escape_latex(text: str) -> str:
    """Return `text` escaped, so that LaTeX prints it unchanged."""
    escaped = "".join(_LATEX.get(letter, letter) for letter in plain_text(text))
    return escaped.replace("--", "-{}-").replace("--", "-{}-")  # LaTeX would turn two hyphens into a dash


def escape_csv(text: str) -> str:
    """Return `text` in a form that spreadsheets do not read as a formula. Numbers and "--" are unchanged."""
    return formula_safe(plain_text(text).strip())


def _markdown_line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _markdown_cell(cell: TableCell, marks: dict[str, str]) -> str:
    text = escape_markdown(cell.text)
    text = f"**{text}**" if cell.bold else text
    footnotes = ",".join(marks[note] for note in cell.footnotes)
    return f"{text}<sup>{footnotes}</sup>" if footnotes else text


def _without_empty_columns(table: Table) -> Table:
    """Return the table without columns that contain only "--". A note lists the omitted columns."""
    cells = [[row.cells[number] for row in table.rows] for number in range(len(table.columns))]
    kept = [n for n, column in enumerate(cells) if any(cell.text != NOT_AVAILABLE for cell in column)]
    if not kept or len(kept) == len(cells):
        return table
    omitted = [number for number in range(len(cells)) if number not in kept]
    # If an omitted title also occurs in the table, add the headings above the title.
    titles = {table.columns[number].title for number in kept}
    names = dict.fromkeys(
        column.full_title if column.title in titles else column.title
        for column in (table.columns[number] for number in omitted)
    )
    why = dict.fromkeys(note for number in omitted for cell in cells[number] for note in cell.footnotes)
    reasons = f" ({'; '.join(why)})" if why else ""
    return replace(
        table,
        columns=tuple(table.columns[number] for number in kept),
        rows=tuple(replace(row, cells=tuple(row.cells[n] for n in kept)) for row in table.rows),
        notes=(*table.notes, f"columns without values are omitted: {', '.join(names)}{reasons}"),
    )


def _latex_headings(table: Table) -> list[str]:
    """Return the header lines of a table.

    A rule is drawn below each level of headings. The titles come last.
    """
    lines = []
    first = len(table.heads) + 1
    for level in range(table.depth):
        cells, rules, at = [""] * len(table.heads), [], first
        for heading, span in table.spans(level):
            text = rf"\textbf{{{escape_latex(heading)}}}" if heading else ""
            cells.append(rf"\multicolumn{{{span}}}{{c}}{{{text}}}")
            rules += [rf"\cmidrule(lr){{{at}-{at + span - 1}}}"] if heading else []
            at += span
        lines += [" & ".join(cells) + r" \\", "".join(rules)]
    titles = [rf"\textbf{{{escape_latex(head)}}}" for head in table.heads]
    titles += [escape_latex(column.title) for column in table.columns]
    return [*lines, " & ".join(titles) + r" \\"]


def _latex_rows(table: Table, marks: dict[str, str]) -> list[str]:
    """Return the lines of all rows. If a label repeats the label in the row above, it is left blank."""
    lines: list[str] = []
    width = len(table.heads) + len(table.columns)
    section = ""
    for (heading, upper_labels), rows in groupby(table.rows, lambda row: (row.section, row.labels[:-1])):
        lines += [r"\midrule"] if lines else []
        if heading and heading != section:
            title = rf"\multicolumn{{{width}}}{{c}}{{\textit{{{escape_latex(heading)}}}}} \\"
            lines += [title, r"\midrule"]
        section = heading
        first = [escape_latex(label) for label in upper_labels]
        for row in rows:
            last = escape_latex(row.labels[-1])
            last = rf"\textbf{{{last}}}" if row.strong else rf"\emph{{{last}}}" if row.paper else last
            cells = (_latex_cell(cell, marks) for cell in row.cells)
            lines.append(" & ".join([*first, last, *cells]) + r" \\")
            first = [""] * len(upper_labels)
    return lines


def _latex_cell(cell: TableCell, marks: dict[str, str]) -> str:
    # Print a dash for missing values and small capitals for N/A, as in the paper.
    text = {"--": "--", "N/A": r"\textsc{N/A}"}.get(cell.text) or escape_latex(cell.text)
    text = rf"\textbf{{{text}}}" if cell.bold else text
    footnotes = ",".join(marks[note] for note in cell.footnotes)
    return rf"{text}\textsuperscript{{{footnotes}}}" if footnotes else text
