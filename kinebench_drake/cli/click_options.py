"""Options of commands, made of those that configurations declare."""

import errno
import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import click

from kinebench_drake.errors import UsageError, name_options, printable
from kinebench_drake.runs.option import Option, options_of

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def echo(line: object, *, err: bool = False) -> None:
    """Print a line that may hold labels and names of files, whatever these contain."""
    click.echo(printable(str(line)), err=err)


class PathParameter(click.Path):
    """Path on the command line. An empty one, as of an unset variable, is refused: it would be the current folder."""

    def __init__(self, **options: Any) -> None:
        """Create the type; `options` are those of `click.Path`."""
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; fails if it is empty, or not as the options demand."""
        if not os.fspath(value):
            self.fail("the path is empty", param, ctx)
        try:
            os.stat(value)
        except OSError as error:
            if error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
                self.fail(f"{os.fspath(value)[:60]}...: {error.strerror}", param, ctx)
        return super().convert(value, param, ctx)


class GroupedCommand(click.Command):
    """Command whose help lists its options in groups."""

    def __init__(self, *args: Any, groups: Mapping[str, Sequence[str]], **settings: Any) -> None:
        """Create the command; `groups` has the names of options by title, and may name some that it does not have."""
        super().__init__(*args, **settings)
        self._groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the options group by group, those of no group last."""
        options = [param for param in self.get_params(ctx) if isinstance(param, click.Option)]
        records = {option.name: record for option in options if (record := option.get_help_record(ctx))}
        groups = [(title, [records.pop(n) for n in names if n in records]) for title, names in self._groups.items()]
        for title, rows in (*groups, ("Other options", list(records.values()))):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def config_options(
    config: type, *names: str, omit: Collection[str] = (), defaults: Mapping[str, object] | None = None
) -> Decorator:
    """Return a decorator that adds the options of a configuration.

    Args:
        names: options to add, in this order; all if there are none.
    """
    options = options_of(config)
    chosen = [options[name] for name in names or options if name not in omit]

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(chosen):
            function = _click_option(option, (defaults or {}).get(option.name, option.default))(function)
        return function

    return add


def _click_option(option: Option, default: Any) -> Decorator:
    settings: dict[str, Any] = {"help": name_options(option.help), "metavar": option.metavar}
    if option.kind is Mapping:
        settings |= {"multiple": True, "callback": _pairs}
    elif default is not None:
        value = default.value if isinstance(default, Enum) else default
        settings |= {"default": value, "show_default": value is not False}
    elif option.required:
        settings["required"] = True
    if option.kind is bool:
        settings["is_flag"] = True
    elif option.kind is not Mapping:
        settings["type"] = _click_type(option)
    return click.option(*option.flags, option.name, **settings)


def _click_type(option: Option) -> "click.ParamType[Any]":
    """Return the type of an option; what click cannot check the configuration does."""
    if issubclass(option.kind, Enum):
        return click.Choice([member.value for member in option.kind])
    if option.choices:
        return click.Choice(option.choices)
    if option.kind is Path:
        return PathParameter()
    if option.kind is int:
        return click.IntRange(option.least, option.most)
    return click.FLOAT if option.kind is float else click.STRING


def _pairs(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for value in values:
        match = re.fullmatch(r"([^=]+)=(.*)", value, re.DOTALL)
        if not match:
            raise click.BadParameter(f"{value!r} is not of the form KEY=VALUE", ctx, param)
        if match[1] in pairs:
            raise click.BadParameter(f"{match[1]!r} is given twice, expected each KEY once", ctx, param)
        pairs[match[1]] = match[2]
    return pairs


SIZES = click.IntRange(128, 2048)
"""Side lengths of images [px]."""


def check_parent(option: str, path: Path) -> None:
    """Check, before long work, that the folder of an output file exists.

    Raises:
        UsageError: it does not.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}; create it first")


def check_suffix(option: str, path: Path | None, *suffixes: str) -> None:
    """Check, before long work, that the name of an output file ends in one of `suffixes`; None for no file.

    Raises:
        UsageError: it does not.
    """
    if path is not None and path.suffix.lower() not in suffixes:
        raise UsageError(f"{option} {path.name}: expected a name that ends in {' or '.join(suffixes)}")
