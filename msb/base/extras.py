"""Optional packages: check whether they are installed, and report how to install them."""

from importlib.util import find_spec

from msb.errors import UsageError


def is_installed(module: str) -> bool:
    """Return whether the top-level `module` is installed. It is not imported."""
    return find_spec(module) is not None


def install(extra: str) -> str:
    """Return the command that installs `extra`, with quotes that every shell understands."""
    return f'pip install "meshsplatbench[{extra}]"'


def need_extra(extra: str, *modules: str, what: str, instead: str = "") -> None:
    """Check that the `modules` of `extra` are installed.

    Parameters
    ----------
    extra : str
        Name of the extra in pyproject.toml.
    *modules : str
        Top-level modules.
    what : str
        What needs them: the subject of the message, such as "an MP4 film".
    instead : str
        A sentence about what works without them, in lower case.

    Raises
    ------
    UsageError
        EXTRA_MISSING, with the command that installs the extra.
    """
    missing = [module for module in modules if not is_installed(module)]
    if missing:
        are = "is" if len(missing) == 1 else "are"
        text = f"{what} needs the extra {extra} ({', '.join(missing)} {are} not installed): {install(extra)}"
        raise UsageError("EXTRA_MISSING", f"{text}; {instead}" if instead else text)
