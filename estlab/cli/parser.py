"""argparse as estlab's own commands use it: one line for a mistake, with the nearest flag; help of 80 columns."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Generic, NoReturn, TypeVar

from estlab.errors import UserError
from estlab.launch.path_arguments import home

Options = TypeVar("Options", bound=argparse.Namespace)
Value = TypeVar("Value")

_WIDTH = 80  # columns of a help text


class Parser(argparse.ArgumentParser):
    """The parser of a command. Flags and words may come in any order; no flag is abbreviated."""

    def __init__(self, command: str, usage: str, description: str, epilog: str = "") -> None:
        super().__init__(
            prog=f"estlab {command}".strip(),
            usage=f"estlab {usage}",
            description=description,
            epilog=epilog,
            formatter_class=_Formatter,
            add_help=False,
            allow_abbrev=False,
            exit_on_error=False,
        )
        self.add_argument("-h", "--help", action="help", help="show this help")

    def read(self, arguments: Sequence[str], options: Options) -> Options:
        """Set the arguments as attributes of ``options`` and return it.

        Raises UserError for an unknown flag and for a missing or wrong value, SystemExit after --help.
        """
        try:
            _, unknown = self.parse_known_intermixed_args(arguments, options)
        except argparse.ArgumentError as error:
            raise UserError(f"{self._described(error)} (see {self.prog} --help)") from error
        if unknown:
            word = unknown[0].partition("=")[0]
            raise UserError(f"{self.prog} has no {word}{self._nearest(word)} (see {self.prog} --help)")
        return options

    def flags(self) -> list[str]:
        """The long flags, for the shell to complete."""
        return [flag for action in self._actions for flag in action.option_strings if flag.startswith("--")]

    def error(self, message: str) -> NoReturn:
        """Raise UserError, where argparse prints two lines and exits."""
        raise UserError(f"{self.prog}: {message} (see {self.prog} --help)")

    def _described(self, error: argparse.ArgumentError) -> str:
        """The flag and what is wrong with its value, with the values that it accepts if it has none."""
        named = next((one for one in self._actions if "/".join(one.option_strings) == error.argument_name), None)
        flag = str(error.argument_name).partition("/")[0]
        if named and error.message == "expected one argument":
            return f"{flag} takes {named.type.takes if isinstance(named.type, Checked) else 'a value'}"
        return f"{flag} {error.message}"

    def _nearest(self, word: str) -> str:
        from estlab.config.build import nearest

        return nearest(word, self.flags())


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Keeps the line ends of description and epilog; prints the flags in two columns."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=24, width=_WIDTH)


class Checked(Generic[Value]):
    """The type of an argument: its conversion, which raises ValueError, and a description of valid values."""

    def __init__(self, convert: Callable[[str], Value], takes: str) -> None:
        self.convert, self.takes = convert, takes

    def __call__(self, text: str) -> Value:
        try:
            return self.convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"takes {self.takes}, got {text!r}") from error


def _text(text: str) -> str:
    if not text:
        raise ValueError("empty")
    return text


def _path(text: str) -> Path:
    return Path(home(_text(text)))


def _folder(text: str) -> Path:
    if not _path(text).is_dir():
        raise ValueError(text)
    return _path(text)


TEXT = Checked(_text, "a value")
FILE = Checked(_path, "a file")
CONFIG_FOLDER = Checked(_folder, "a folder of configuration")
