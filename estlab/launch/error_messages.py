"""Turns the errors of Hydra, OmegaConf and YAML, which take several lines, into one line."""

import contextlib
import re
from collections.abc import Sequence

from estlab.config.locations import groups
from estlab.errors import PluginError, UserError
from estlab.launch.known_keys import known_keys

# Hydra's messages about missing places of configuration, by the flag that names them.
_PLACES = {
    "--config-dir": ("folder", r"Additional config directory '(.*)' not found"),
    "--config-name": ("configuration", r"Cannot find primary config '(.*?)'"),
    "--config-path": ("folder or module", r"config (?:directory|module) '(.*?)'"),
}


def one_line(error: Exception, arguments: Sequence[str]) -> str:
    """Hydra's and OmegaConf's messages, of several lines, as one that names the key and the nearest known one.

    arguments: as Hydra received them.
    """
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, PluginError):
        return f"{error}; HYDRA_FULL_ERROR=1 shows the traceback"
    text = "\n".join(filter(None, [str(error), str(error.__cause__ or "")]))
    for flag, (kind, missing) in _PLACES.items():
        if found := re.search(missing, text):
            return f"{flag}: there is no {kind} {found[1]}"
    if several := re.search(r"Ambiguous value for argument '(.*?)'\n", text, re.DOTALL):
        return f"{several[1]}: a run takes one value; use estlab sweep for several, or brackets for a list, [a,b]"
    for explain in (_unknown_key, _unknown_option, _no_list, _of_another_kind, _taken_away):
        if said := explain(text, arguments):
            return said
    if re.search(r"Lexer|Error parsing override|OverrideParse", f"{type(error).__name__} {text}"):
        return f"{_unparsed(arguments)}: write key=value, with quotes around values that contain special characters"
    # What a resolver such as ${deg:...} complains of says all by itself.
    text = re.sub(r"^\w+ raised while resolving interpolation: ", "", str(error))
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    key = next((f"{line.removeprefix('full_key: ')}: " for line in lines if line.startswith("full_key: ")), "")
    said = key + "; ".join(line for line in lines if not re.match("full_key: |(object|reference)_type=", line))
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'the system'}: {error.strerror}"
    speaks_for_itself = isinstance(error, ValueError | HydraException | OmegaConfBaseException)
    return said if speaks_for_itself and said else f"{type(error).__name__}: {said}"


def _unknown_key(text: str, arguments: Sequence[str]) -> str:
    from estlab.config.build import unknown_key

    match = re.search(r"Could not override '([^']+)'|Could not delete from config\. '([^']+)' does not exist", text)
    if not match:
        return ""
    wrong = (match[1] or match[2]).lstrip("+")
    if wrong == "experiment":
        written = next((word for word in arguments if word.partition("=")[0] == wrong), wrong)
        return f"write +{written}: an experiment is added to the configuration"
    if "@" in wrong:
        return f"{wrong}: there is nothing at this place; write +{wrong}=... to add a choice of the group"
    known = known_keys(arguments, wrong)
    if wrong in known:
        return f"{wrong} is not a key of every job of this sweep"
    among = re.match(r"filters\.([\w-]+)\.", wrong)
    if among and f"filters.{among[1]}" not in known:
        one = wrong.replace(among[0], "filter.")
        return f"{wrong}: none of these filters is called {among[1]}; for a single filter write {one}"
    return unknown_key(wrong, known)


def _unknown_option(text: str, arguments: Sequence[str]) -> str:
    from estlab.config.build import nearest

    listed = r"Could not find '([^']+)'\s*(?:Available options in '[^']+':\s*(.*?)\s*(?:Config search path|$))?"
    match = re.search(listed, text, re.DOTALL)
    if not match:
        return ""
    group = max(
        (one for one in groups() if match[1].startswith(f"{one}/")), key=len, default=match[1].rpartition("/")[0]
    )
    option = match[1].removeprefix(f"{group}/")
    options = (match[2] or "").split()
    among = f" (one of {', '.join(options)})" if options else ""
    return f"there is no {group or 'config'} {option}{nearest(option, options)}{among}"


def _no_list(text: str, arguments: Sequence[str]) -> str:
    match = re.search(r"invalid literal for int\(\) with base 10: '(\w+)'", text)
    if not match:
        return ""
    for key, _, value in (word.lstrip("+").partition("=") for word in arguments):
        stem, dot, rest = key.partition(f".{match[1]}")
        if dot and not rest and stem.startswith("expect."):
            return f"{key}: {stem} is a list here; replace it whole, as {stem}={{{match[1]}: {value}}}"
    return ""


def _of_another_kind(text: str, arguments: Sequence[str]) -> str:
    match = re.search(r"Error merging override (.*?)\n([^\n]+)(?:\n    full_key|\Z)", text, re.DOTALL)
    if not match:
        return ""
    word, why = match.groups()
    if "DictConfig with ListConfig" in why:
        value = word.partition("=")[2].strip()
        why = "is a list; write key=[...]" if value.startswith("{") else "is a group of keys; write key={...}"
        why = why.replace("key=", f"{word.partition('=')[0]}=")
    return f"{word}: {why}"


def _taken_away(text: str, arguments: Sequence[str]) -> str:
    """A message for a missing key or choice that others need."""
    choice = re.search(r"hydra[:.]runtime\.choices\.(\w+)", text)
    key = re.search(r"Key '[^']+' is not in struct\s+full_key: ([\w.]+)", text)
    if choice:
        return f"{choice[1]} is missing, but every run needs one; write {choice[1]}=NAME (see estlab list)"
    return f"{key[1]} is missing, but other keys refer to it" if key else ""


def _unparsed(arguments: Sequence[str]) -> str:
    """The first of the words that Hydra's grammar does not accept."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    parser = OverridesParser.create()
    for word in arguments:
        if word.startswith("-"):
            continue
        try:
            with contextlib.suppress(RecursionError):
                parser.parse_override(word)
        except HydraException:
            return word
    return "the command line"
