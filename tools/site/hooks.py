"""Hooks of the site: pages outside of docs/, titles of links, and tables from the code.

MkDocs calls these functions by name (mkdocs.yml, hooks).
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from tools.site.tables import AT_THE_END

ROOT = Path(__file__).parents[2]
MEASURED = sorted((ROOT / "benchmarks" / "pages").glob("*.md"))
PAGES = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "benchmarks/README.md": "measurements/index.md",
    **{f"benchmarks/pages/{path.name}": f"measurements/{path.name}" for path in MEASURED},
}
"""The pages on the site of files outside of docs/."""
TAGS = re.compile(r"(<[^>]*>)")
OPTION = re.compile(r"(?<![\w-])--?[a-z][\w-]*")
BREAKABLE = re.compile(r"(?<=\w\w)(?:[/_|](?=\w\w)|[.,=](?=[a-zA-Z]\w))")
BEFORE_A_UNIT = re.compile(r"(?<=\d) (?=(?:%|dB|[kKMGT]i?B|ms|s)(?!\w))")


def on_files(files: Any, config: Any) -> Any:
    """Add pages from the root and from benchmarks/."""
    from mkdocs.structure.files import File

    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        text = re.sub(r"\]\((?:\.\./)?docs/", "](" + "../" * page.count("/"), text)
        text = re.sub(r"\]\(pages/", "](", text)
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append the tables generated from the code to a page, and give its links the titles of their targets."""
    if page.file.src_uri in AT_THE_END:
        markdown = f"{markdown}\n\n{AT_THE_END[page.file.src_uri]()}"
    folder = (ROOT / "docs" / page.file.src_uri).parent
    named = r"\[[\w./]+\.md\]\(([\w./]+\.md)(?:#([\w-]+))?\)"
    markdown = re.sub(named, lambda link: _by_title(folder, *link.group(1, 2)), markdown)
    up = "../" * page.file.src_uri.count("/")
    for name, place in PAGES.items():
        markdown = re.sub(rf"\]\((?:\.\./)*{re.escape(name)}", f"]({up}{place}", markdown)
    return markdown


def _by_title(folder: Path, target: str, anchor: str | None) -> str:
    """Return a link. If its text is a file name, the title of its target replaces the text."""
    from markdown.extensions.toc import slugify

    place = Path(os.path.normpath(folder / target))  # pages of other folders are not in docs/
    text = (place if place.exists() else ROOT / target).read_text(encoding="utf-8")
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    title = next((head for head in heads if slugify(head, "-") == anchor), heads[0])
    return f"[{title}]({target}{'#' + anchor if anchor else ''})"


def on_page_content(html: str, **_: Any) -> str:
    """Allow or prevent line breaks in code of tables, in options, and between a number and its unit."""
    pieces = TAGS.split(html)
    in_code = in_table = False
    for number, piece in enumerate(pieces):
        if number % 2:
            in_code = piece.startswith("<code") or (in_code and piece != "</code>")
            in_table = piece.startswith("<table") or (in_table and piece != "</table>")
        elif in_code:
            # A name in a table is broken behind a separator only (style.css), so that columns can be narrow.
            text = BREAKABLE.sub(r"\g<0><wbr>", piece) if in_table else piece
            pieces[number] = OPTION.sub(r'<span class="option">\g<0></span>', text)
        else:
            text = BEFORE_A_UNIT.sub("\N{NO-BREAK SPACE}", piece)
            text = BREAKABLE.sub(r"\g<0><wbr>", text) if in_table else text
            pieces[number] = OPTION.sub(r'<span class="option">\g<0></span>', text) if in_table else text
    return "".join(pieces)


def on_post_template(output_content: str, **_: Any) -> str:
    """Apply this also to pages without a document (404)."""
    return on_post_page(output_content)


def on_post_page(output: str, **_: Any) -> str:
    """Replace a script that the search plugin would load from the network."""
    shim = Path(__file__).with_name("search_frame.js").read_text(encoding="utf-8")
    output = re.sub(
        r'<script src="https://unpkg[^"]*"></script>', lambda _: f"<script>{shim}</script>", output
    )
    fetched = re.findall(r'(?:<link[^>]*href|src)="(https?://[^"]*)"', output)
    if fetched:
        from mkdocs.exceptions import PluginError

        raise PluginError(f"a page would load from the network: {fetched[0]}")
    return output.replace("path - like</code>", "path-like</code>")
