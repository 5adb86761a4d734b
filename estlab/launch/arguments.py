"""Prepares a command line for Hydra: fixes or refuses what Hydra would misread or report badly."""

import importlib.util
import re
from collections.abc import Sequence

from estlab.config.locations import groups
from estlab.errors import UserError
from estlab.launch.given_keys import other_data
from estlab.launch.path_arguments import home, is_path, quoted_path

CONFIG_DIR = ("--config-dir", "-cd")

_WITH_VALUE = {
    **dict.fromkeys(("--cfg", "-c"), "--cfg"),
    **dict.fromkeys(("--package", "-p"), "--package"),
    **dict.fromkeys(("--config-path", "-cp"), "--config-path"),
    **dict.fromkeys(("--config-name", "-cn"), "--config-name"),
    **dict.fromkeys(CONFIG_DIR, "--config-dir"),
}
_CFG_OF = ("job", "hydra", "all")
_INFO, _INFO_ON = ("--info", "-i"), ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
_FLAGS = {
    *("--help", "-h", "--hydra-help", "--version", "--resolve", "--run", "-r", "--multirun", "-m"),
    *("--shell-completion", "-sc", *_INFO, *_WITH_VALUE),
}
# These come before the typed words, which add to them. In a sweep only typed expectations apply: a file's belong to
# its own values, not to the swept ones. Jobs have no pages, unless requested.
OF_A_SWEEP = ("expect=null", "expect_files=null", "report=false")
# For an experiment on a recording, its file's expectations and number of runs do not apply; its expectations of that
# recording, under expect_files, do.
_OF_OTHER_DATA = ("expect=null", "runs=1")

_NO_NAME = re.compile(r"\s*(null|true|false|\?\?\?|[-+]?([\d.]+(e[-+]?\d+)?|inf|nan))\s*", re.IGNORECASE)
_DIGITS = 1000  # digits of a number, for which Python has its own limit
_DEEPEST = 20  # nested brackets in a value; no key needs more than a few

# Plugins by the package that they need, and the extra of estlab that installs it.
_NEEDS = {
    "hydra/launcher=dask": ("distributed", "dask"),
    "hydra/launcher=joblib": ("hydra_plugins.hydra_joblib_launcher", "joblib"),
    "hydra/launcher=ray": ("hydra_plugins.hydra_ray_launcher", "ray"),
    "hydra/launcher=submitit_local": ("hydra_plugins.hydra_submitit_launcher", "submitit"),
    "hydra/launcher=submitit_slurm": ("hydra_plugins.hydra_submitit_launcher", "submitit"),
    "hydra/sweeper=optuna": ("optuna", "optuna"),
}


def prepared(arguments: list[str]) -> list[str]:
    """The arguments as Hydra expects them: flags first, each with its value in one word, then keys.

    Raises UserError for an unknown flag, for a folder without a name, and for a value that is nested too deep.
    """
    flags, words = parted(arguments)
    sweep = is_sweep(flags, words)
    for word in words:
        if not word.partition("=")[0].strip("+~ "):
            raise UserError(f"{word!r}: write key=value")
        if none := re.fullmatch(r"\+*(output|sweep\.dir|hydra\.(?:run|sweep)\.dir)=(?:null|''|\"\"|\?\?\?|\s*)", word):
            raise UserError(f"{word}: {none[1]} must be a folder, for example {none[1]}=runs")
        _check_choice(word)
        _check_size(word)
        _check_installed(word)
    words = [quoted_path(word, sweep) for word in _file_names(_expectations(_several_filters(words)))]
    experiment = any(word.startswith("+experiment=") for word in words)
    ours = [*OF_A_SWEEP * sweep, *_OF_OTHER_DATA * (experiment and other_data(words))]
    return [*flags, *(ours if words and words[: len(ours)] != ours else []), *words]


def parted(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Flags, each with its value in one word, and the other words."""
    flags: list[str] = []
    words: list[str] = []
    rest = list(arguments)
    while rest:
        argument = rest.pop(0)
        flag, equals, value = argument.partition("=")
        if not argument.startswith("-"):
            words.append(argument)
        elif flag not in _FLAGS:
            raise UserError(f"unknown flag {argument}; {_instead(argument)}")
        elif flag in _INFO:
            found = value if equals else rest.pop(0) if rest and rest[0] in _INFO_ON else "all"
            _check_among(flag, found, _INFO_ON)
            flags.append(f"--info={found}")
        elif flag not in _WITH_VALUE:
            if equals:
                raise UserError(f"{flag} takes no value; write {flag}")
            flags.append(argument)
        elif not (value or rest):
            raise UserError(f"{flag} takes a value")
        else:
            value = value if equals else rest.pop(0)
            if _WITH_VALUE[flag] == "--cfg":
                _check_among(flag, value, _CFG_OF)
            flags.append(f"{_WITH_VALUE[flag]}={home(value) if flag in CONFIG_DIR else value}")
    return flags, words


def _check_among(flag: str, value: str, known: Sequence[str]) -> None:
    from estlab.config.build import nearest

    if value not in known:
        raise UserError(f"{flag} takes {', '.join(known)}; got {value}{nearest(value, known)}")


def _instead(argument: str) -> str:
    """A suggestion for an unknown flag."""
    from estlab.config.build import nearest

    flag, equals, _ = argument.partition("=")
    if flag in ("--resume", "--dry-run"):
        return f"estlab sweep takes {flag}"
    known = [*_WITH_VALUE, "--resume"] if equals else [*_FLAGS, "--resume", "--dry-run"]
    near = nearest(flag, known).removeprefix("; ")
    plain = argument.lstrip("-")
    return near or (f"write {plain} without dashes" if equals else "estlab run --hydra-help lists them")


def is_sweep(flags: Sequence[str], words: Sequence[str]) -> bool:
    """Whether these words make a sweep."""
    mode = any(re.fullmatch(r"\+*hydra\.mode=.*MULTIRUN.*", word) for word in words)
    return mode or bool({"-m", "--multirun"} & set(flags))


def _check_choice(word: str) -> None:
    """A group's choice must be a name, or names in a list; Hydra's own message for anything else names no key."""
    key, _, value = word.partition("=")
    if key.lstrip("+").partition("@")[0] not in groups():
        return
    for name in re.split(r"[\[\],]", value):
        if _NO_NAME.fullmatch(name) or re.match(r"\s*\[\s*\[", value):
            raise UserError(f"{word}: write the name of one (see estlab list)")


def _check_size(word: str) -> None:
    """Hydra's parsers recurse for each bracket, and become ever slower."""
    key, _, value = word.partition("=")
    brackets = value if not is_path(key) else "".join(re.findall(r"\$\{|\}", value))
    depth = deepest = 0
    for sign in brackets:
        depth += (sign in "[{(") - (sign in "]})")
        deepest = max(deepest, depth)
    if deepest > _DEEPEST:
        raise UserError(f"{word[:40]}...: brackets lie more than {_DEEPEST} deep; no key needs such a value")
    if re.search(rf"\d{{{_DIGITS}}}", brackets):
        raise UserError(f"{word[:40]}...: the number is too large")


def _expectations(arguments: list[str]) -> list[str]:
    """expect.rmse.x=[0.1,0.2] in a form that Hydra accepts: a key that may be new, and a value that does not merge."""
    written: list[str] = []
    for argument in arguments:
        match = re.fullmatch(r"\+{0,2}(expect(?:\.[^=]+)?)=(.*)", argument, re.DOTALL)
        words = [argument]
        if argument == "~expect" or re.fullmatch(r"\+{0,2}expect=\s*(null|\{\s*\})?\s*", argument):
            words = ["expect=null", "expect_files=null"]
        elif match is not None:
            key, value = match.groups()
            words = [f"++{key}=null"] * value.lstrip().startswith(("[", "{")) + [f"++{key}={value}"]
        # Words already in this form stay unchanged.
        written += words[1:] if written[-1:] == words[:1] else words
    return written


def _file_names(arguments: list[str]) -> list[str]:
    """data.files.truth=mine.mat in a form that Hydra accepts: a key that is new."""
    return [re.sub(r"^\+{0,2}(data\.files\.[^=]+=)", r"++\1", argument) for argument in arguments]


def _check_installed(argument: str) -> None:
    if argument.lstrip("+") not in _NEEDS:
        return
    module, extra = _NEEDS[argument.lstrip("+")]
    if importlib.util.find_spec(module.partition(".")[0]) is None or importlib.util.find_spec(module) is None:
        raise UserError(f"{argument} needs more: pip install 'estlab[{extra}]'")


def _several_filters(arguments: list[str]) -> list[str]:
    """filter=[ekf,ukf] in a form that Hydra accepts: each filter in its own place under filters."""
    written: list[str] = []
    for argument in arguments:
        group, equals, choice = argument.lstrip("+").partition("=")
        if group == "scenario" and choice.startswith("["):
            raise UserError(f"{argument}: a run has one scenario; use estlab sweep scenario=car,field for several")
        if group != "filter" or not equals or (choice and "[" not in choice):
            written.append(argument)
            continue
        names = re.fullmatch(r"\[\s*((?!null\b)[\w./-]+(?:\s*,\s*(?!null\b)[\w./-]+)*)\s*\]", choice)
        several = re.split(r"\s*,\s*", names[1]) if names else []
        if not several or len(several) != len(set(several)):
            raise UserError(
                f"{argument}: name each filter once in one list, such as filter=[ekf,ukf]; lists cannot be swept"
            )
        written += [f"filter={several[0]}", *(f"+filter@filters.{name}={name}" for name in several)]
        written.append(f"hydra.job.name={'-'.join(several)}")
    return written
