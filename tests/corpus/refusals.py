"""All bad checkpoints, meshes, camera files and scenes, with their error codes and messages.

The messages of all bad files are stored in tests/golden/refusals.json, one line per file. After an intended
change of a message, run `python -m tests.corpus.refusals` and read the diff.
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

MESSAGES = Path(__file__).parents[1] / "golden" / "refusals.json"
_FOREIGN = re.compile(r"((?:is not|cannot be) (?:JSON|read|opened|listed|UTF-8|decoded)): .*", re.DOTALL)
"""Pattern of messages that end with a text of Python, a library or the system.

Such a text depends on versions.
"""

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
"""All bad files by kind and name.

Each has an error code, and a function that writes the file to a folder and reads it. Bad assets are tested in
tests/asset/test_bad_assets.py.
"""


@cache
def read_messages() -> dict[str, str]:
    """Return the messages of all bad files by kind and name."""
    messages: dict[str, str] = json.loads(MESSAGES.read_text(encoding="utf-8"))
    return messages


def without_foreign_text(message: str) -> str:
    """Return a message without text of Python, libraries and the system."""
    return _FOREIGN.sub(r"\1", message)


def find_message(findings: list[Finding], code: str) -> str:
    """Return the message of the first finding with this code."""
    return without_foreign_text(next(item.message for item in findings if item.code == code))


def _write() -> None:
    messages = {}
    with tempfile.TemporaryDirectory() as temporary:
        for case in bad_assets.CASES:
            path = bad_assets.write_case(case, Path(temporary))
            try:
                report = (msb.validate if case.found_by == "command" else validate)(path)
                messages[f"asset/{case.name}"] = find_message(list(report.findings), case.code)
            except InputError as error:
                messages[f"asset/{case.name}"] = without_foreign_text(error.message)
            except StopIteration:  # permissions are not checked for root
                pass
    for name, (_, read) in REFUSED.items():
        with tempfile.TemporaryDirectory() as temporary:
            try:
                read(Path(temporary))
            except MsbError as error:
                messages[name] = without_foreign_text(error.message.replace(temporary, ""))
    text = json.dumps(messages, indent=0, sort_keys=True, ensure_ascii=False) + "\n"
    MESSAGES.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    _write()
