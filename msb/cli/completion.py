"""`msb completion`: print the script that completes commands and options in a shell."""

from typing import Annotated, Literal

from msb.base.option import Argument
from msb.cli.command import command
from msb.cli.output import echo


@command("msb completion bash", "msb completion zsh", "msb completion powershell")
def completion(
    shell: Annotated[
        Literal["bash", "zsh", "fish", "powershell"],
        Argument("bash, zsh, fish or powershell.", metavar="SHELL"),
    ],
) -> None:
    """Print a completion script for msb and msb-audit.

    Save the script where the shell looks for completions:

    \b
    bash        ~/.local/share/bash-completion/completions/msb
    zsh         a file _msb in a folder of $fpath
    fish        ~/.config/fish/completions/msb.fish
    PowerShell  msb completion powershell >> $PROFILE
    """
    # Typer does not export this function. The documented option --show-completion guesses the shell instead.
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    for name in ("msb", "msb-audit"):
        variable = f"_{name.replace('-', '_').upper()}_COMPLETE"
        echo(get_completion_script(prog_name=name, complete_var=variable, shell=shell))
