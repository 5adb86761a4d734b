"""Texts as values of Hydra's grammar, and back."""

import re

from estlab.config.angles import is_angle

# A backslash counts only before a quote; the quote that ends the text has an even number of them before it.
QUOTED = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*\"""", re.DOTALL)


def quoted(text: str) -> str:
    """The value that stands for this text, whatever it contains; ${...} in it is still an interpolation."""
    escaped = re.sub(r"(\\*)('|\Z)", lambda found: 2 * found[1] + ("\\'" if found[2] else ""), text)
    return f"'{escaped}'"


def literal(text: str) -> str:
    """The text in a form that OmegaConf returns unchanged, without interpolation."""
    return re.sub(r"(\\*)\$\{", lambda found: 2 * found[1] + r"\${", text)


def unquoted(value: str) -> str:
    """The text that a quoted value stands for; any other value unchanged."""
    if not QUOTED.fullmatch(value):
        return value
    return re.sub(rf"((?:\\\\)*)(\\?)({value[0]}|\Z)", _unescaped, value[1:-1])


def _unescaped(found: "re.Match[str]") -> str:
    return "\\" * (len(found[1]) // 2) + found[3]


def angle_as_typed(value: str) -> str:
    """One of several values as Hydra writes it: an angle ${deg:40} without its backslashes, any other as it is."""
    plain = re.sub(r"\\(.)", r"\1", value)
    return plain if is_angle(plain) else value


def elements(value: str) -> list[str]:
    """The values between the commas of a value; a comma in quotes does not separate."""
    parts, begin = [], 0
    for found in re.finditer(rf"{QUOTED.pattern}|,", value, re.DOTALL):
        if found[0] == ",":
            parts.append(value[begin : found.start()].strip())
            begin = found.end()
    return [*parts, value[begin:].strip()]
