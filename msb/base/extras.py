"""Optional packages: whether one is installed, and the one error that says how to install it."""

from importlib.util import find_spec

from msb.errors import UsageError


def is_installed(module: str) -> bool:
    """Return whether the top-level `module` could be imported; the module is looked for, not loaded."""
    return find_spec(module) is not None


def install(extra: str) -> str:
    """Return the command that installs `extra`, quoted for every shell."""
    return f'pip install "meshsplatbench[{extra}]"'


def need_extra(extra: str, *modules: str, what: str, instead: str = "") -> None:
    """Raise an error if one of `modules`, which `extra` installs, is missing.

    `what` needs them, the subject of the sentence ("an MP4 film"); `instead` says what works without them, as
    a sentence that begins in lower case.
    """
    absent = [module for module in modules if not is_installed(module)]
    if absent:
        are = "is" if len(absent) == 1 else "are"
        lacking = f"{', '.join(absent)} {are} not installed"
        text = f"{what} needs the extra {extra} ({lacking}): {install(extra)}"
        raise UsageError("EXTRA_MISSING", f"{text}; {instead}" if instead else text)
