"""What makes a command of a function: options from the dataclasses that it takes, and rules between them.

A function that is decorated with `command` has parameters of these kinds:

- a dataclass, whose fields become options as their `Option` says; the function is handed the object. With a
  tuple of names, ``Annotated[Views, ("cameras", "size")]``, only these fields do, and the others keep their
  defaults. The files of `Output`, a dataclass as well, are checked before the function runs;
- anything else that is annotated with an `Argument` or `Option`;
- `Typed`, the names of the parameters that are on the command line.

A parameter of the type Path is a path, and the `output` of its `Option` says whether it is written.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from msb.base.atomic import is_stream
from msb.base.option import Argument, Option
from msb.cli.output import Output, is_stdout, open_log, place_of
from msb.errors import MsbError, UsageError, shorten


@dataclass(frozen=True)
class Everywhere:
    """The options of every command. A command with an option of the same name keeps its own."""

    color: Annotated[
        Literal["auto", "always", "never"] | None,
        Option("Colour the output: on terminals (auto), always or never."),
    ] = None
    log_file: Annotated[
        Path | None,
        Option("Append notes, errors, steps and their times to FILE.", metavar="FILE", output="own"),
    ] = None
    debug: Annotated[bool, Option("Show the traceback of an error.", only_typed=True)] = False


class Typed(frozenset[str]):
    """The names of the parameters that are on the command line: not set by a file or variable."""


class Rule(NamedTuple):
    """Options that may not be given, or that must be.

    Attributes
    ----------
    options : str
        Parameters, separated by blanks. Without any, the rule is that something is missing.
    text : str
        What is wrong; the name of the first of `options` that is typed stands before it.
    needs, excludes : str
        The rule is broken unless, or if, one of these parameters has a value, or this value:
        ``tier=dedicated``.
    """

    options: str
    text: str
    needs: str = ""
    excludes: str = ""


class _Declared(NamedTuple):
    """A parameter of a command line."""

    name: str
    type: Any
    option: Option
    default: Any

    @property
    def label(self) -> str:
        """What it is called in the help."""
        if isinstance(self.option, Argument):
            return str(self.option.metavar).rstrip(".")
        flag = next((flag for flag in self.flags if flag.startswith("--")), self.flags[0])
        return flag.partition("/")[0]  # --paper of --paper/--no-paper

    @property
    def flags(self) -> tuple[str, ...]:
        """How it is typed."""
        return self.option.flags or (f"--{self.name.replace('_', '-')}",)

    @property
    def is_path(self) -> bool:
        """Whether its values are paths."""
        return Path in (self.type, *get_args(self.type))

    @property
    def parameter(self) -> inspect.Parameter:
        """What the command-line library reads."""
        option, kind = self.option, self.type
        if get_origin(kind) is tuple:
            kind = list[get_args(kind)[0]]  # type: ignore[misc]
        default = [] if self.default == () else self.default
        number = {int: "N", float: "X"}.get(
            next((one for one in (kind, *get_args(kind)) if one in (int, float)), str)
        )
        shared: dict[str, Any] = {
            "help": option.help,
            "metavar": option.metavar or (None if option.count else number),
            "min": option.least,
            "max": option.most,
            # A file that may not be read is for its reader to report, with its code and status.
            "readable": False,
        }
        if isinstance(option, Argument):
            info = typer.Argument(hidden=True, **shared)  # `Command` writes its line of the help
        else:
            info = typer.Option(*self.flags, count=option.count, show_default=not option.count, **shared)
        given = inspect.Parameter.empty if default is MISSING else default
        return inspect.Parameter(
            self.name, inspect.Parameter.KEYWORD_ONLY, default=given, annotation=Annotated[kind, info]
        )


class _Group(NamedTuple):
    """A dataclass that a function takes, and the options that its fields become."""

    kind: type
    declared: tuple[_Declared, ...]

    def made(self, values: Mapping[str, Any]) -> Any:
        """Return the object with its values of all `values`."""
        return self.kind(**{each.name: values[each.name] for each in self.declared})


def plain_words(text: str, error: Any) -> str:
    """Return `text` of an error of the command-line library as one line without the words of its validator.

    These leave out the value, which then stands before what it must be.
    """
    text = " ".join(text.split()).rstrip(".").replace("Value error, ", "")
    before, said, wanted = text.partition("Input should be ")
    if not said:
        return text
    given = shorten(str(error.__cause__.errors()[0]["input"]), 40)
    return f'{before}it is "{given}"; it must be {wanted.partition(", unable")[0]}'


_LIBRARY: Any = TyperCommand.context_class
_UNBROKEN = "\ue000"
"""It stands for a hyphen inside a word while lines are broken."""
_HYPHEN = re.compile(r"(?<=\S)-(?=\S)")


class _WholeWords(_LIBRARY.formatter_class):  # type: ignore[misc]
    def write_text(self, text: str) -> None:
        super().write_text(_HYPHEN.sub(_UNBROKEN, text))

    def write_dl(self, rows: Any, *args: Any, **options: Any) -> None:
        kept = [tuple(_HYPHEN.sub(_UNBROKEN, text) for text in row) for row in rows]
        super().write_dl(kept, *args, **options)

    def getvalue(self) -> str:
        return str(super().getvalue()).replace(_UNBROKEN, "-")


class Context(_LIBRARY):  # type: ignore[misc]
    """What the library makes of a command's words, its help among them."""

    formatter_class = _WholeWords


class Command(TyperCommand):
    """A command of ours: it refuses what the library takes in silence, before anything is opened or read.

    These are an option of one value that is given twice, of which the last would count; an empty path, which
    would be the current folder; and an empty name, which would count as none.
    """

    context_class = Context

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and refuse repeated options and empty paths and names."""
        if not ctx.resilient_parsing:  # at the Tab key nothing is complete
            values, _, order = self.make_parser(ctx).parse_args(args=list(args))
            param: Any
            for param in self.params:
                declared = self.callback.declared[param.name]  # type: ignore[union-attr]
                many = param.param_type_name == "argument" or param.multiple or param.count or param.is_flag
                if not many and order.count(param) > 1:
                    ctx.fail(f"{declared.label} is given {order.count(param)} times; it takes one value")
                given: Any = values.get(param.name)
                if declared.is_path and "" in (given if isinstance(given, list | tuple) else [given]):
                    ctx.fail(f"{declared.label} is empty, which names no file; . is the current folder")
                if given == "" and declared.option.metavar in ("NAME", "TEMPLATE"):
                    ctx.fail(f"{declared.label} is empty, which names nothing")
        return super().parse_args(ctx, args)

    def get_help(self, ctx: Any) -> str:
        """Return the help page, in which {mesh_suffixes} stands for those of the formats there are."""
        if "{mesh_suffixes}" in (self.help or ""):
            from msb.meshes import MESH_SUFFIXES

            self.help = str(self.help).replace("{mesh_suffixes}", ", ".join(MESH_SUFFIXES))
        return super().get_help(ctx)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage: arguments that may be left out in brackets."""
        words = [(param, str(param.metavar)) for param in self._arguments(ctx)]
        return ["[OPTIONS]", *(word if param.required else f"[{word}]" for param, word in words)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, which are hidden from the library, and the library's list of options."""
        if arguments := self._arguments(ctx):
            with formatter.section("Arguments"):
                formatter.write_dl([(param.metavar, param.help) for param in arguments])
        super().format_options(ctx, formatter)

    def _arguments(self, ctx: Any) -> list[Any]:
        return [param for param in self.get_params(ctx) if param.param_type_name == "argument"]


@contextlib.contextmanager
def option_value(label: str) -> Iterator[None]:
    """Make of an error about a value one of wrong usage that names the option."""
    try:
        yield
    except MsbError as error:
        raise UsageError("USAGE", f"{label}: {error.message}") from error


def command(
    *examples: str, rules: Sequence[Rule] = (), name: str = "", **settings: Any
) -> Callable[..., Any]:
    """Return the decorator that makes a command of a function; `settings` are the command-line library's."""
    named = {"epilog": epilog(*examples), "settings": settings, **({"name": name} if name else {})}
    return functools.partial(_command, rules, named)


def _command(
    rules: Sequence[Rule], named: dict[str, Any], function: Callable[..., Any]
) -> Callable[..., Any]:
    groups: dict[str, _Group] = {}
    declared: list[_Declared] = []
    taken = inspect.signature(function, eval_str=True).parameters
    for each in taken.values():
        kind, *marks = (
            get_args(each.annotation) if get_origin(each.annotation) is Annotated else [each.annotation]
        )
        if kind is Typed:
            continue
        if isinstance(kind, type) and is_dataclass(kind):
            names = next((mark for mark in marks if isinstance(mark, tuple)), None)
            groups[each.name] = _Group(kind, tuple(_fields(kind, names)))
            declared += groups[each.name].declared
        else:
            option = next(mark for mark in marks if isinstance(mark, Option))
            default = MISSING if each.default is inspect.Parameter.empty else each.default
            declared.append(_Declared(each.name, kind, option, default))
    own = {each.name for each in declared}
    everywhere = tuple(each for each in _fields(Everywhere, None) if each.name not in own)
    declared = list(_with_needs([*declared, *everywhere], rules))
    searched = {each.label for each in declared if each.option.searched}
    outputs = next((key for key, group in groups.items() if issubclass(group.kind, Output)), None)

    def run(context: typer.Context, **values: Any) -> Any:
        values = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
        _check_apart(declared, values)
        _prepare(_Group(Everywhere, everywhere).made(values))
        sources = {key: getattr(context.get_parameter_source(key), "name", "") for key in values}
        typed = Typed(key for key, source in sources.items() if source == "COMMANDLINE")
        _check_rules(rules, declared, values, typed)
        objects = {key: group.made(values) for key, group in groups.items()}
        if outputs is not None:
            for kind, label, path in _paths(declared, values):
                if kind != "folder":  # for files in it each has a place of its own
                    objects[outputs].keep(label, path, written=kind is not None, searched=label in searched)
            _check_free(declared, values, objects[outputs])
        alone = {key: values.get(key, typed) for key in taken if key not in groups}
        try:
            return function(**objects, **alone)
        except MsbError as error:
            if outputs is not None:
                objects[outputs].reword(error)
            raise

    functools.update_wrapper(run, function)
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    run.__signature__ = inspect.Signature([context, *(each.parameter for each in declared)])  # type: ignore[attr-defined]
    run.__annotations__ = {"context": typer.Context}
    declared_by_name = {each.name: each for each in declared}
    vars(run).update({"name": function.__name__.replace("_", "-"), "declared": declared_by_name, **named})
    return run


def _with_needs(declared: Sequence[_Declared], rules: Sequence[Rule]) -> Iterator[_Declared]:
    """Yield parameters, the help of which says which option they need."""
    labels = {each.name: each.label for each in declared}
    needed = {
        key: labels[rule.needs] for rule in rules if rule.needs in labels for key in rule.options.split()
    }
    for each in declared:
        label, text = needed.get(each.name), each.option.help
        if label and label not in text:
            each = each._replace(option=replace(each.option, help=f"{text.rstrip('.')}. Needs {label}."))
        yield each


def _fields(kind: type, names: tuple[str, ...] | None) -> Iterator[_Declared]:
    hints = get_type_hints(kind, include_extras=True)
    known = {field.name: field for field in fields(kind)}
    for name in names or known:
        option = next((mark for mark in get_args(hints[name]) if isinstance(mark, Option)), None)
        if option is not None:
            yield _Declared(name, get_args(hints[name])[0], option, known[name].default)


def _prepare(everywhere: Everywhere) -> None:
    """Set the variables of colour, which what prints reads, our child processes included; open the log."""
    for variable, wish in (("FORCE_COLOR", "always"), ("NO_COLOR", "never")):
        if everywhere.color is not None:
            os.environ.pop(variable, None)
        if everywhere.color == wish:
            os.environ[variable] = "1"
    if everywhere.log_file is not None:
        open_log(everywhere.log_file)


def _check_apart(declared: Sequence[_Declared], values: dict[str, Any]) -> None:
    """Refuse outputs that are an input or another output, also by a link or in another spelling.

    Streams can take several outputs.
    """
    named = [(kind in ("file", "own"), label, path) for kind, label, path in _paths(declared, values)]
    if not any(written for written, _, _ in named):
        return
    seen: dict[object, str] = {}
    for written, label, path in sorted(named, key=lambda one: one[0]):
        if is_stdout(path) or is_stream(path):
            continue
        key = place_of(path)
        if written and key in seen:
            text = f"{label} and {seen[key]} name the same file; an output needs a place of its own"
            raise UsageError("USAGE", text, file=path)
        seen[key] = label


def _paths(declared: Sequence[_Declared], values: dict[str, Any]) -> Iterator[tuple[str | None, str, Path]]:
    """Yield each path that is given, how it is written (None for an input), and the label of its option."""
    for each in declared:
        value = values.get(each.name)
        if each.is_path and value is not None:
            for path in value if isinstance(value, tuple) else (value,):
                yield each.option.output, each.label, path


def _check_rules(
    rules: Sequence[Rule], declared: Sequence[_Declared], values: dict[str, Any], typed: Typed
) -> None:
    """Raise UsageError for the first rule that is broken."""
    known = {each.name: each for each in declared}

    def holds(conditions: str) -> bool:
        for condition in conditions.split():
            key, equals, wanted = condition.partition("=")
            value = values[key]
            # 0 is a value, though it equals False.
            if value == wanted if equals else value is not None and value is not False and value != ():
                return True
        return False

    for rule in rules:
        if holds(rule.needs) or (rule.excludes and not holds(rule.excludes)):
            continue
        if not rule.options:
            raise UsageError("USAGE", rule.text)
        for key in rule.options.split():
            if key in typed and holds(key):
                raise UsageError("USAGE", f"{known[key].label} {rule.text}")


def _check_free(declared: Sequence[_Declared], values: dict[str, Any], output: Output) -> None:
    """Refuse files to write that have a wrong ending or are there already."""
    for each in declared:
        path = values.get(each.name)
        if path is not None and each.option.endings:
            from msb.delivery.saving import checked_ending

            checked_ending(path, each.label, each.option.endings)
        if path is not None and each.option.output == "file":
            output.check_free(path)
            output.check_unnamed(path)


_EXIT_TABLE = (
    "Exit status: 0 done, 1 a gate or validation failed, 2 wrong usage, 3 input\n"
    "missing or not valid, 4 not supported, 5 no OpenCL device, 130 interrupted."
)

_DEMO_DATA = "The examples' files are there after: msb demo-data data_stubs"


def epilog(*examples: str) -> str:
    """Return the end of a help page: examples as they are, the exit statuses, and where data is from."""
    lines = "\n".join(f"  {example}" for example in examples)
    data = f"\n\n{_DEMO_DATA}" if "data_stubs" in lines else ""
    return f"\b\nExamples:\n{lines}\n\n\b\n{_EXIT_TABLE}{data}"
