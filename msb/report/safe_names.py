"""Make names from result files safe to use as file names, as anchors and as one line of text."""

import hashlib
import re
import unicodedata

# Maximum length of the readable part of a slug, in characters. File systems allow names of 255 bytes. The
# file name of a verdict page contains three slugs.
_MAX_SLUG_LENGTH = 60


def slug(name: str) -> str:
    """Return a file name or anchor for `name`: letters, digits, "_" and "." only.

    If a name has other characters, a hash is added at its end, so that different names give different
    results.

    Examples
    --------
    >>> slug("garden"), slug("../a b")
    ('garden', 'a_b-2c2c79')
    """
    plain = re.sub(r"[^A-Za-z0-9_.]+", "_", name)[:_MAX_SLUG_LENGTH].strip("._")
    if plain == name and name:
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:6]
    return f"{plain}-{digest}" if plain else digest


def plain_text(text: str) -> str:
    """Return `text` on one line, without control, formatting and unpaired surrogate characters."""
    spaced = (" " if letter.isspace() else letter for letter in text)
    return "".join(letter for letter in spaced if unicodedata.category(letter) not in ("Cc", "Cf", "Cs"))
