"""`msb submit`: results made fit to be published."""

from pathlib import Path
from typing import Annotated

from msb.base.option import Argument, Option
from msb.cli.command import command
from msb.cli.output import JsonOutput, echo, file_option
from msb.errors import UsageError

_MOST_NAME = 60


@command("msb submit out/one -o out/ours.zip --name 'Our lab'")
def submit(
    results: Annotated[Path, Argument("The folder that msb run wrote.", metavar="RESULTS")],
    out: Annotated[Path, file_option("Where the submission goes.", "--out", "-o", endings=(".zip",))],
    name: Annotated[str, Option("What you want to be called on the board.", metavar="NAME")],
    *,
    output: JsonOutput,
) -> None:
    """Make of results one file to be published: records, hashes, commands, a few pictures.

    Only numbers, hashes, versions, and names of scenes, methods and devices are published. msb report makes a
    board of such files.
    The same results give the same bytes.
    """
    from hashlib import sha256

    from msb.base.atomic import new_file
    from msb.bench.submission import write_submission
    from msb.report.board import submitted_pictures
    from msb.report.results import read_results

    if not 0 < len(name.strip()) <= _MOST_NAME or not name.isprintable():
        raise UsageError("USAGE", f"--name: it must have 1 to {_MOST_NAME} printable characters")
    with output.progress("reading results"):
        found = read_results(results)
    records = [loaded.result for loaded in found]
    with output.progress(f"packing {len(records)} results"):
        pictures = submitted_pictures(found)
        data = write_submission(name.strip(), records, pictures)
        with new_file(out, size=len(data), overwrite=output.force) as file:
            file.write(data)
    hashed = sha256(data).hexdigest()
    output.write_json(
        {
            "schema": "msb.submit/1",
            "output": str(out),
            "name": name.strip(),
            "sha256": hashed,
            "bytes": len(data),
            "records": len(records),
            "pictures": len(pictures),
        }
    )
    if output.prints_text:
        echo(
            f"{out}: {len(records)} results, {len(pictures)} pictures, {len(data):,} bytes, SHA-256 {hashed}"
        )
        if not output.quiet:
            echo("paths and messages are not published; names of scenes and images are: check them")
