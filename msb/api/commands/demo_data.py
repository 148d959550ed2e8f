"""`msb demo-data`: write the scenes and models of the examples."""

from pathlib import Path
from typing import Annotated

from msb.base.option import Argument
from msb.base.paths import shell_word
from msb.cli.command import command
from msb.cli.output import PlainOutput, echo


@command("msb demo-data out/demo-data")
def demo_data(
    target: Annotated[Path, Argument("Folder to write.", metavar="DIR", output="own")],
    output: PlainOutput,
) -> None:
    """Write small scenes, trained models and protocols to try every command on (8 MB, no download).

    For each dataset there is a scene in its layout, with models by four methods. There are also a checkpoint,
    an asset with the typical defects of trained models, cameras, and two protocols: one for two scenes and
    one for all. --force replaces demo data in DIR and keeps all other files.
    """
    from msb.api.demo import PROTOCOL, RESULTS, write_demo

    output.check_folder(target)
    with output.progress(f"writing {target.name}"):
        size = write_demo(target, overwrite=output.force)
    echo(
        f"{target}: 4 scenes, 10 models, a checkpoint, an asset, cameras, two protocols; {size / 1e6:.1f} MB"
    )
    if not output.quiet:
        names = ("splat_like.triasset", PROTOCOL, RESULTS)
        asset, protocol, results = (shell_word(target / name) for name in names)
        echo(f"next: msb audit {asset}")
        echo(f"      msb run {protocol}")
        echo(f"      msb report {results}")
