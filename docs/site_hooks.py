"""What the site needs beside docs/: files of the root as pages, links to them, and tables of the code's own.

MkDocs calls these functions by their names (mkdocs.yml, hooks).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docs.tables import AT_THE_END

ROOT = Path(__file__).parent.parent
PAGES = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "SECURITY.md": "security.md"}
"""File beside docs/ -> the page that it is."""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that lie in the root, for GitHub's sake."""
    from mkdocs.structure.files import File

    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        text = re.sub(r"\]\(docs/", "](", text)
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Add the tables that the code has for a page, and let links to files of the root lead to their pages."""
    if page.file.src_uri in AT_THE_END:
        markdown = f"{markdown}\n\n{AT_THE_END[page.file.src_uri]()}"
    up = "../" * page.file.src_uri.count("/")
    for name, place in PAGES.items():
        markdown = re.sub(rf"\]\((?:\.\./)*{re.escape(name)}", f"]({up}{place}", markdown)
    return markdown


def on_post_template(output_content: str, **_: Any) -> str:
    """Treat pages that are no document (404) alike."""
    return on_post_page(output_content)


def on_post_page(output: str, **_: Any) -> str:
    """Put our own script in the place of one that the search plugin would fetch from elsewhere."""
    shim = (ROOT / "docs" / "search_frame.js").read_text(encoding="utf-8")
    output = re.sub(
        r'<script src="https://unpkg[^"]*"></script>', lambda _: f"<script>{shim}</script>", output
    )
    fetched = re.findall(r'(?:<link[^>]*href|src)="(https?://[^"]*)"', output)
    if fetched:
        from mkdocs.exceptions import PluginError

        raise PluginError(f"a page asks the network for {fetched[0]}")
    return output.replace("<code>path - like</code>", "<code>path-like</code>")
