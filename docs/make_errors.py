"""Write docs/errors.md from the table of codes: `python -m docs.make_errors`."""

from __future__ import annotations

from pathlib import Path

from msb.errors import CODES, EXIT_STATUS

PAGE = Path(__file__).with_name("errors.md")
HEAD = """# Error codes

Made by `python -m docs.make_errors` from `msb/errors.py`: change that, not this.

Every failure has a code that stays the same from release to release; the message behind it may change. The
command line prints `CODE: FILE: what is wrong, where, and what would be right` and ends with the status of
the code's class. `msb validate --explain CODE` prints the row below. In a report of `msb validate` the same
codes also stand for warnings and infos, which leave the status 0.
"""


def page() -> str:
    """Return docs/errors.md: one table for each class of errors."""
    parts = [HEAD]
    for kind, status in EXIT_STATUS.items():
        rows = [
            f"| `{name}` | {code.summary} | {code.remedy} |"
            for name, code in CODES.items()
            if code.kind is kind
        ]
        if rows:
            title = f"## `{kind.__name__}`, exit status {status}"
            parts.append(
                "\n".join(
                    [
                        title,
                        "",
                        kind.__doc__ or "",
                        "",
                        "| code | meaning | remedy |",
                        "|---|---|---|",
                        *rows,
                        "",
                    ]
                )
            )
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
