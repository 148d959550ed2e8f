"""The command `msb submit`: package results for publication."""

from pathlib import Path
from typing import Annotated

from msb.base.option import Argument, Option
from msb.cli.command import command
from msb.cli.output import JsonOutput, echo, file_option
from msb.errors import UsageError

# Maximum length of a submitter's name in characters. A longer name would not fit into a column of the board.
_MAX_NAME_LENGTH = 60


@command("msb submit out/one -o out/ours.zip --name 'Our lab'")
def submit(
    results: Annotated[Path, Argument("Results folder of msb run.", metavar="RESULTS")],
    out: Annotated[Path, file_option("The submission to write.", "--out", "-o", endings=(".zip",))],
    name: Annotated[str, Option("Your name on the board.", metavar="NAME")],
    *,
    output: JsonOutput,
) -> None:
    """Package results into a single file for publication.

    The file contains the records with hashes, the commands and a few images. Only numbers, hashes, versions,
    and names of scenes, methods and devices are published. Equal results give equal files. msb report makes a
    board from such files.
    """
    from hashlib import sha256

    from msb.base.atomic import new_file
    from msb.bench.submission import write_submission
    from msb.report.board import submitted_pictures
    from msb.report.results import read_results

    if not 0 < len(name.strip()) <= _MAX_NAME_LENGTH or not name.isprintable():
        raise UsageError("USAGE", f"--name: the name must have 1 to {_MAX_NAME_LENGTH} printable characters")
    with output.progress("reading results"):
        loaded_results = read_results(results)
    records = [loaded.result for loaded in loaded_results]
    with output.progress(f"packing {len(records)} results"):
        pictures = submitted_pictures(loaded_results)
        data = write_submission(name.strip(), records, pictures)
        with new_file(out, size=len(data), overwrite=output.force) as file:
            file.write(data)
    digest = sha256(data).hexdigest()
    output.write_json(
        {
            "schema": "msb.submit/1",
            "output": str(out),
            "name": name.strip(),
            "sha256": digest,
            "bytes": len(data),
            "records": len(records),
            "pictures": len(pictures),
        }
    )
    if output.prints_text:
        echo(f"{out}: {len(records)} results, {len(pictures)} images, {len(data):,} bytes, SHA-256 {digest}")
        if not output.quiet:
            echo(
                "Paths and messages were removed. Names of scenes and images are published: "
                "check the file before you publish it."
            )
