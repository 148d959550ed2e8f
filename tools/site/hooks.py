"""What the site needs beside docs/: pages of other folders, links by titles, the code's own tables.

MkDocs calls these functions by their names (mkdocs.yml, hooks).
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
"""File beside docs/ -> its page on the site."""
TAGS = re.compile(r"(<[^>]*>)")
OPTION = re.compile(r"(?<![\w-])--?[a-z][\w-]*")
BEFORE_A_UNIT = re.compile(r"(?<=\d) (?=(?:%|dB|[kKMGT]i?B|ms|s)(?!\w))")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie outside of docs/: those of the root and of benchmarks/."""
    from mkdocs.structure.files import File

    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        text = re.sub(r"\]\((?:\.\./)?docs/", "](" + "../" * page.count("/"), text)
        text = re.sub(r"\]\(pages/", "](", text)
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Add the tables that the code has for a page, and lead links to pages, by their titles."""
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
    """Return the link with the title of the section or page as its text, where the text was a file's name."""
    from markdown.extensions.toc import slugify

    place = Path(os.path.normpath(folder / target))  # a page of another folder has none in docs/
    text = (place if place.exists() else ROOT / target).read_text(encoding="utf-8")
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    title = next((head for head in heads if slugify(head, "-") == anchor), heads[0])
    return f"[{title}]({target}{'#' + anchor if anchor else ''})"


def on_page_content(html: str, **_: Any) -> str:
    """Keep together what must not part at the end of a line: an option, and a number with its unit."""
    pieces = TAGS.split(html)
    in_code = False
    for number, piece in enumerate(pieces):
        if number % 2:
            in_code = piece.startswith("<code") or (in_code and piece != "</code>")
        elif in_code:
            pieces[number] = OPTION.sub(r'<span class="option">\g<0></span>', piece)
        else:
            pieces[number] = BEFORE_A_UNIT.sub("\N{NO-BREAK SPACE}", piece)
    return "".join(pieces)


def on_post_template(output_content: str, **_: Any) -> str:
    """Treat pages that are no document (404) alike."""
    return on_post_page(output_content)


def on_post_page(output: str, **_: Any) -> str:
    """Put our own script in the place of one that the search plugin would fetch from elsewhere."""
    shim = Path(__file__).with_name("search_frame.js").read_text(encoding="utf-8")
    output = re.sub(
        r'<script src="https://unpkg[^"]*"></script>', lambda _: f"<script>{shim}</script>", output
    )
    fetched = re.findall(r'(?:<link[^>]*href|src)="(https?://[^"]*)"', output)
    if fetched:
        from mkdocs.exceptions import PluginError

        raise PluginError(f"a page asks the network for {fetched[0]}")
    return output.replace("path - like</code>", "path-like</code>")
