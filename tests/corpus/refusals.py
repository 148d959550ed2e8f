"""Every bad checkpoint, mesh, source of cameras and scene: a code says what to do, a message what is wrong.

The messages of all bad files are kept in tests/golden/refusals.json, one line for each file.
`python -m tests.corpus.refusals` writes them again after a message was changed on purpose; read the
difference like code.
"""

import json
import re
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import msb
from msb.asset import validate
from msb.errors import Finding, InputError, MsbError
from tests.adapters import bad_checkpoints
from tests.corpus import bad_assets
from tests.meshes import bad_files
from tests.scenes import bad_cameras
from tests.scenes.datasets import bad_scenes

KEPT = Path(__file__).parents[1] / "golden" / "refusals.json"
_FOREIGN = re.compile(r"((?:is not|cannot be) (?:JSON|read|opened|listed|UTF-8|decoded)): .*", re.DOTALL)
"""What follows is said by Python, a library or the system, each version in its own words."""

REFUSED: dict[str, tuple[str, Callable[[Path], object]]] = {
    **{
        f"checkpoint/{case.name}": (case.code, partial(bad_checkpoints.read_case, case))
        for case in bad_checkpoints.CASES
    },
    **{
        f"{kind}/{name}": (code(table[name]), partial(read, name))
        for kind, table, code, read in (
            ("cameras", bad_cameras.BAD, lambda bad: bad[2], bad_cameras.read_case),
            ("mesh", bad_files.BAD, lambda bad: bad[2], bad_files.read_case),
            ("scene", bad_scenes.BAD, lambda bad: bad[2], bad_scenes.read_case),
        )
        for name in table
    },
}
"""Kind and name -> code, and a function that writes the file below a folder and reads it. Assets have a test
of their own."""


@cache
def kept() -> dict[str, str]:
    """Return kind and name of a bad file -> its message."""
    words: dict[str, str] = json.loads(KEPT.read_text(encoding="utf-8"))
    return words


def own_words(message: str) -> str:
    """Return a message without the words of others in it."""
    return _FOREIGN.sub(r"\1", message)


def of_case(findings: list[Finding], code: str) -> str:
    """Return the message of the finding of a case."""
    return own_words(next(item.message for item in findings if item.code == code))


def _write() -> None:
    words = {}
    with tempfile.TemporaryDirectory() as temporary:
        for case in bad_assets.CASES:
            path = bad_assets.write_case(case, Path(temporary))
            try:
                found = (msb.validate if case.found_by == "command" else validate)(path)
                words[f"asset/{case.name}"] = of_case(list(found.findings), case.code)
            except InputError as error:
                words[f"asset/{case.name}"] = own_words(error.message)
            except StopIteration:  # permissions, which root need not have
                pass
    for name, (_, read) in REFUSED.items():
        with tempfile.TemporaryDirectory() as temporary:
            try:
                read(Path(temporary))
            except MsbError as error:
                words[name] = own_words(error.message.replace(temporary, ""))
    KEPT.write_text(json.dumps(words, indent=0, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    _write()
