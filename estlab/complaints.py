"""Errors of Hydra, OmegaConf and YAML, which take several lines, said in one."""

import contextlib
import re

from estlab.errors import PluginError, UserError
from estlab.paths import conf_folder


def one_line(error: Exception, arguments: list[str]) -> str:
    """Hydra's and OmegaConf's messages, of several lines, as one that names the key and the nearest known one."""
    from estlab.config import nearest, unknown_key

    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, PluginError):
        return f"{error}; HYDRA_FULL_ERROR=1 shows the traceback"
    text = "\n".join(filter(None, [str(error), str(error.__cause__ or "")]))
    if match := re.search(r"Could not override '([^']+)'", text):
        wrong = match[1].lstrip("+")
        written = next((word for word in arguments if word.partition("=")[0] == wrong), wrong)
        if wrong == "experiment":
            return f"write +{written}: an experiment is added to the configuration"
        known = _known_keys(arguments)
        if among := re.match(r"filters\.(\w+)\.", wrong):
            one = wrong.replace(among[0], "filter.")
            if one in known:
                return f"{wrong}: there is no {among[1]} among several filters here; a single one takes {one}"
            alone = unknown_key(one, known)
            return re.sub(r"\bfilter\.", among[0], alone)
        return f"{wrong} is not a key of every job here" if wrong in known else unknown_key(wrong, known)
    if match := re.search(
        r"Could not find '([^']+)'\s*(?:Available options in '[^']+':\s*(.*?)\s*(?:Config search path|$))?",
        text,
        re.DOTALL,
    ):
        group, _, option = match[1].rpartition("/")
        options = (match[2] or "").split()
        return f"there is no {group or 'config'} {option}{nearest(option, options)}" + (
            f" (one of {', '.join(options)})" if options else ""
        )
    if match := re.search(r"invalid literal for int\(\) with base 10: '(\w+)'", text):
        for key, _, value in (word.lstrip("+").partition("=") for word in arguments):
            stem, dot, rest = key.partition(f".{match[1]}")
            if dot and not rest and stem.startswith("expect."):
                return f"{key}: {stem} is a list here; replace it whole, as {stem}={{{match[1]}: {value}}}"
    said = "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
    if re.search(r"Lexer|Error parsing override", said):
        return f"{said.split('; ')[0]}: write key=value, with quotes around values that have other signs in them"
    return said if isinstance(error, ValueError) and said else f"{type(error).__name__}: {said}"


def _known_keys(arguments: list[str]) -> list[str]:
    """Every group and key of the configuration that the group choices among the arguments compose."""
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException

    from estlab.config import key_paths

    groups = [folder.name for folder in conf_folder().iterdir() if folder.is_dir() and folder.name != "hydra"]
    chosen = [argument for argument in arguments if argument.partition("=")[0] in groups]
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        for overrides in (chosen, []):
            with contextlib.suppress(HydraException):
                return [*groups, *key_paths(compose("config", overrides=overrides))]
    return groups
