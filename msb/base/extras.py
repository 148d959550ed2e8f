"""Optional packages: check whether they are installed, and report how to install them."""

from collections.abc import Iterable, Mapping
from importlib.util import find_spec

from msb.errors import UsageError


def is_installed(module: str) -> bool:
    """Return whether the top-level `module` is installed. The module is not imported."""
    return find_spec(module) is not None


def install(extra: str) -> str:
    """Return the command that installs `extra`, quoted so that every shell understands it."""
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
        The feature that needs the modules, as the subject of the message, such as "an MP4 film".
    instead : str
        A sentence in lower case about an alternative that works without the modules.

    Raises
    ------
    UsageError
        EXTRA_MISSING, with the command that installs the extra.
    """
    need_extras({extra: modules}, what=what, instead=instead)


def need_extras(extras: Mapping[str, Iterable[str]], *, what: str, instead: str = "") -> None:
    """Check the modules of several extras, as `need_extra` does for one extra.

    A single error names all missing modules.
    """
    missing = {
        extra: absent
        for extra, modules in extras.items()
        if (absent := [module for module in modules if not is_installed(module)])
    }
    if missing:
        names = [module for modules in missing.values() for module in modules]
        are = "is" if len(names) == 1 else "are"
        noun = "the extra" if len(missing) == 1 else "the extras"
        text = f"{what} needs {noun} {' and '.join(missing)} ({', '.join(names)} {are} not installed)"
        text += f": {install(','.join(missing))}"
        raise UsageError("EXTRA_MISSING", f"{text}; {instead}" if instead else text)
