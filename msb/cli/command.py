"""Turn a function into a command. Parameters whose type is a dataclass become several options.

A function that is decorated with `command` has parameters of these kinds:

- A dataclass. The dataclass fields with an `Option` become options, and the function receives an object of
  the dataclass. With ``Annotated[Views, ("cameras", "size")]`` only the fields `cameras` and `size` become
  options. All other fields keep their defaults. The class `Output` is also a dataclass of options. If the
  function takes an `Output`, all paths are checked before the function runs.

- Other parameters with an annotation `Argument` or `Option`.

- `Typed`, the parameters that the user gave on the command line.

A parameter of type Path is an input, unless the `output` of its `Option` is set.
"""

import contextlib
import functools
import inspect
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from msb.base.option import Argument, Option
from msb.cli.output import Output, open_log
from msb.errors import MsbError, UsageError, shorten


@dataclass(frozen=True)
class Everywhere:
    """The options that every command has. A command can define a different option with the same name."""

    color: Annotated[
        Literal["auto", "always", "never"] | None,
        Option("Colour the output: on terminals (auto), always or never."),
    ] = None
    log_file: Annotated[
        Path | None,
        Option("Append notes, errors, steps and their times to FILE.", metavar="FILE", output="own"),
    ] = None
    debug: Annotated[bool, Option("Show the traceback of an error.")] = False


class Typed(dict[str, str]):
    """The parameters given on the command line, and their labels, such as ``--size`` for ``size``."""

    def reject(self, names: Iterable[str], text: str) -> None:
        """Raise a UsageError if one of these parameters is given on the command line. The message consists of
        the label of the parameter and `text`."""
        for name in names:
            if name in self:
                raise UsageError("USAGE", f"{self[name]} {text}")


class _Declared(NamedTuple):
    """A parameter of a command: its name in the function, its type, its `Option` and its default."""

    name: str
    type: Any
    option: Option
    default: Any

    @property
    def label(self) -> str:
        """The name of the parameter in the help."""
        if isinstance(self.option, Argument):
            return str(self.option.metavar).rstrip(".")
        flag = next((flag for flag in self.flags if flag.startswith("--")), self.flags[0])
        return flag.partition("/")[0]  # --paper of --paper/--no-paper

    @property
    def flags(self) -> tuple[str, ...]:
        """The names of the parameter on the command line."""
        return self.option.flags or (f"--{self.name.replace('_', '-')}",)

    @property
    def is_path(self) -> bool:
        """Whether the value is a path or several paths."""
        return Path in (self.type, *get_args(self.type))

    @property
    def parameter(self) -> inspect.Parameter:
        """The parameter in the form that typer reads."""
        option, kind = self.option, self.type
        if get_origin(kind) is tuple:
            kind = list[get_args(kind)[0]]  # type: ignore[misc]
        if get_origin(kind) in (Union, UnionType):  # use the first type of a union on the command line
            kind = get_args(kind)[0] | None
        default = [] if self.default == () else self.default
        number = {int: "N", float: "X"}.get(
            next((part for part in (kind, *get_args(kind)) if part in (int, float)), str)
        )
        shared: dict[str, Any] = {
            "help": option.help,
            "metavar": option.metavar or (None if option.count else number),
            "min": option.least,
            "max": option.most,
            # Typer must not check files, because file readers report errors with a code and an exit status.
            "readable": False,
        }
        if isinstance(option, Argument):
            info = typer.Argument(hidden=True, **shared)  # `Command` writes the arguments into the help
        else:
            info = typer.Option(*self.flags, count=option.count, show_default=not option.count, **shared)
        default = inspect.Parameter.empty if default is MISSING else default
        return inspect.Parameter(
            self.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
        )


class _Group(NamedTuple):
    """A dataclass parameter of a command function, and the options for its fields."""

    kind: type
    declared: tuple[_Declared, ...]

    def build(self, values: Mapping[str, Any]) -> Any:
        """Return an object of the dataclass, with the values of the options."""
        return self.kind(**{parameter.name: values[parameter.name] for parameter in self.declared})


def plain_words(text: str, error: Any) -> str:
    """Return the `text` of a typer error as one line that contains the invalid value."""
    text = " ".join(text.split()).rstrip(".").replace("Value error, ", "")
    before, separator, wanted = text.partition("Input should be ")
    if not separator:
        return text
    value = shorten(str(error.__cause__.errors()[0]["input"]), 40)
    return f'{before}it is "{value}"; it must be {wanted.partition(", unable")[0]}'


# Matches an empty word, or an option with an empty value.
_EMPTY = re.compile(r"(--[\w-]+=)?")


class Command(TyperCommand):
    """A command of typer with a section for arguments in its help. Empty words are errors."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words. Reject empty words, which can come from an unset shell variable."""
        # Some commands pass their words to another program, which may accept empty words. Only commands with
        # `allow_interspersed_args` set to false pass their words on.
        checks = ctx.allow_interspersed_args and not ctx.resilient_parsing
        if checks and any(_EMPTY.fullmatch(word) for word in args):
            ctx.fail("an argument or the value of an option is empty; use . for the current folder")
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage line, with optional arguments in brackets."""
        words = [(param, str(param.metavar)) for param in self._arguments(ctx)]
        return ["[OPTIONS]", *(word if param.required else f"[{word}]" for param, word in words)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments before the options."""
        if arguments := self._arguments(ctx):
            with formatter.section("Arguments"):
                formatter.write_dl([(param.metavar, param.help) for param in arguments])
        super().format_options(ctx, formatter)

    def _arguments(self, ctx: Any) -> list[Any]:
        return [param for param in self.get_params(ctx) if param.param_type_name == "argument"]


def require(condition: object, text: str) -> None:
    """Raise UsageError with `text` unless the condition holds."""
    if not condition:
        raise UsageError("USAGE", text)


@contextlib.contextmanager
def option_value(label: str) -> Iterator[None]:
    """Turn an error about a value into a usage error that names the option `label`."""
    try:
        yield
    except MsbError as error:
        raise UsageError("USAGE", f"{label}: {error.message}") from error


def command(
    *examples: str, name: str = "", instead: Mapping[str, str] | None = None, **settings: Any
) -> Callable[..., Any]:
    """Return the decorator that turns a function into a command.

    Parameters
    ----------
    *examples : str
        Command lines that run on the demo data. The help ends with the examples.
    name : str
        The name of the command; by default the name of the function.
    instead : mapping, optional
        The keys are options that users try, although the command lacks these options. The values are the
        texts that the error suggests instead. In these texts, ":" and the given value replace "{value}".
    **settings
        Context settings of typer.
    """
    named = {
        "epilog": epilog(*examples),
        "settings": settings,
        "instead": instead or {},
        **({"name": name} if name else {}),
    }
    return functools.partial(_command, named)


def _command(named: dict[str, Any], function: Callable[..., Any]) -> Callable[..., Any]:
    groups: dict[str, _Group] = {}
    declared: list[_Declared] = []
    taken = inspect.signature(function, eval_str=True).parameters
    # The options of the function come first, then the options of every command.
    for parameter in taken.values():
        annotation = parameter.annotation
        kind, *marks = get_args(annotation) if get_origin(annotation) is Annotated else [annotation]
        if kind is Typed:
            continue
        if isinstance(kind, type) and is_dataclass(kind):
            names = next((mark for mark in marks if isinstance(mark, tuple)), None)
            groups[parameter.name] = _Group(kind, tuple(_fields(kind, names)))
            declared += groups[parameter.name].declared
        else:
            option = next(mark for mark in marks if isinstance(mark, Option))
            default = MISSING if parameter.default is inspect.Parameter.empty else parameter.default
            declared.append(_Declared(parameter.name, kind, option, default))
    names_of_command = {each.name for each in declared}
    everywhere = tuple(each for each in _fields(Everywhere, None) if each.name not in names_of_command)
    declared += everywhere
    outputs = next((key for key, group in groups.items() if issubclass(group.kind, Output)), None)

    def run(context: typer.Context, **values: Any) -> Any:
        values = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
        sources = {key: getattr(context.get_parameter_source(key), "name", "") for key in values}
        typed = Typed({each.name: each.label for each in declared if sources[each.name] == "COMMANDLINE"})
        objects = {key: group.build(values) for key, group in groups.items()}
        if outputs is not None:
            _check_paths(declared, values, objects[outputs])
        _prepare(_Group(Everywhere, everywhere).build(values))
        others = {key: values.get(key, typed) for key in taken if key not in groups}
        try:
            return function(**objects, **others)
        except MsbError as error:
            if outputs is not None:
                objects[outputs].reword(error)
            raise

    # Typer reads the options from the signature of `run`, and `msb.cli.app` reads the other attributes.
    functools.update_wrapper(run, function)
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    run.__signature__ = inspect.Signature([context, *(each.parameter for each in declared)])  # type: ignore[attr-defined]
    run.__annotations__ = {"context": typer.Context}
    declared_by_name = {each.name: each for each in declared}
    vars(run).update({"name": function.__name__.replace("_", "-"), "declared": declared_by_name, **named})
    return run


def _fields(kind: type, names: tuple[str, ...] | None) -> Iterator[_Declared]:
    """Yield the options of a dataclass, for all its fields or for the fields in `names`."""
    hints = get_type_hints(kind, include_extras=True)
    known = {field.name: field for field in fields(kind)}
    for name in names or known:
        option = next((mark for mark in get_args(hints[name]) if isinstance(mark, Option)), None)
        if option is not None:
            yield _Declared(name, get_args(hints[name])[0], option, known[name].default)


def _prepare(everywhere: Everywhere) -> None:
    """Set the environment variables of --color for child processes, and open the log."""
    for variable, value in (("FORCE_COLOR", "always"), ("NO_COLOR", "never")):
        if everywhere.color is not None:
            os.environ.pop(variable, None)
        if everywhere.color == value:
            os.environ[variable] = "1"
    if everywhere.log_file is not None:
        open_log(everywhere.log_file)


def _check_paths(declared: Sequence[_Declared], values: dict[str, Any], output: Output) -> None:
    """Reject an output that exists, has the wrong suffix, or is also an input or another output."""
    paths = [
        (parameter, path)
        for parameter in declared
        if parameter.is_path and (value := values.get(parameter.name)) is not None
        for path in (value if isinstance(value, tuple) else (value,))
    ]
    for parameter, path in paths:
        if parameter.option.output is None:
            output.add_input(path)
    for parameter, path in paths:
        if parameter.option.output in ("file", "own"):
            output.add_output(path, parameter.label)
        if parameter.option.endings and path.suffix.lower() not in parameter.option.endings:
            endings = ", ".join(parameter.option.endings)
            text = f'{parameter.label} is "{path.name}"; it must end in {endings}'
            raise UsageError("USAGE", text)
        if parameter.option.output == "file":
            output.check_free(path, label=parameter.label)


_EXIT_TABLE = (
    "Exit status: 0 success, 1 a gate or validation failed, 2 wrong usage,\n"
    "3 invalid or missing input, 4 not supported, 5 no OpenCL device,\n"
    "130 interrupted."
)

_DEMO_DATA = "Create the files of the examples with: msb demo-data data_stubs"


def epilog(*examples: str) -> str:
    """Return the end of a help page: examples, exit statuses, and the command that writes the demo data."""
    lines = "\n".join(f"  {example}" for example in examples)
    data = f"\n\n{_DEMO_DATA}" if "data_stubs" in lines else ""
    return f"\b\nExamples:\n{lines}\n\n\b\n{_EXIT_TABLE}{data}"
