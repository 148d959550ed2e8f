"""Write the files of all commands again."""

import tempfile
from pathlib import Path

from tests.snapshots import SEPARATOR, file_of, help_text, names, usual_text


def main() -> None:
    """Write the help and the usual output of each command."""
    for command in ("", *names()):
        text = help_text(command)
        with tempfile.TemporaryDirectory() as folder:
            if usual := usual_text(command, Path(folder)):
                text += SEPARATOR + usual
        file_of(command).write_text(text, encoding="utf-8", newline="\n")
        print(file_of(command).name)


if __name__ == "__main__":
    main()
