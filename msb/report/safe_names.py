"""Names from records made safe: as names of files and anchors, and as text of one line."""

import hashlib
import re
import unicodedata

_MOST = 60


def slug(name: str) -> str:
    """Return `name` if it is plain, else what is plain of it and a hash: no path, no markup, no collision.

    Examples
    --------
    >>> slug("garden"), slug("../a b")
    ('garden', 'a_b-2c2c79')
    """
    plain = re.sub(r"[^A-Za-z0-9_.]+", "_", name)[:_MOST].strip("._")
    if plain == name and name:
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:6]
    return f"{plain}-{digest}" if plain else digest


def plain_text(text: str) -> str:
    """Return `text` on one line, without control, formatting and unpaired surrogate characters."""
    kept = (" " if letter.isspace() else letter for letter in text)
    return "".join(letter for letter in kept if unicodedata.category(letter) not in ("Cc", "Cf", "Cs"))
