"""A command line before Hydra sees it: what Hydra would take wrongly or say badly."""

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
# These stand before what is typed, which adds to them. In a sweep, what is typed alone is expected: a file's
# expectations are of its own values, not of those swept. Nor has each job a page, if none is asked for.
OF_A_SWEEP = ("expect=null", "expect_files=null", "report=false")
# Of an experiment on a recording instead, neither what its file expects nor its number of runs holds; what it expects
# of that recording, under expect_files, does.
_OF_OTHER_DATA = ("expect=null", "runs=1")

_NO_NAME = re.compile(r"\s*(null|true|false|\?\?\?|[-+]?([\d.]+(e[-+]?\d+)?|inf|nan))\s*", re.IGNORECASE)
_DIGITS = 1000  # of a number, for which Python has a limit of its own
_DEEPEST = 20  # brackets in a value, of which no key has more than a few

# Plugins by what they need installed, and the extra of estlab that brings it.
_NEEDS = {
    "hydra/launcher=dask": ("distributed", "dask"),
    "hydra/launcher=joblib": ("hydra_plugins.hydra_joblib_launcher", "joblib"),
    "hydra/launcher=ray": ("hydra_plugins.hydra_ray_launcher", "ray"),
    "hydra/launcher=submitit_local": ("hydra_plugins.hydra_submitit_launcher", "submitit"),
    "hydra/launcher=submitit_slurm": ("hydra_plugins.hydra_submitit_launcher", "submitit"),
    "hydra/sweeper=optuna": ("optuna", "optuna"),
}


def prepared(arguments: list[str]) -> list[str]:
    """The arguments as Hydra takes them: flags first, each with its value in one word, then keys.

    Raises UserError for a flag that there is not, for a folder without a name, and for a value nested too deep.
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
            raise UserError(f"there is no flag {argument}; {_instead(argument)}")
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
    """What may have been meant by a flag that there is not."""
    from estlab.config.build import nearest

    flag, equals, _ = argument.partition("=")
    if flag in ("--resume", "--dry-run"):
        return f"estlab sweep takes {flag}"
    known = [*_WITH_VALUE, "--resume"] if equals else [*_FLAGS, "--resume", "--dry-run"]
    near = nearest(flag, known).removeprefix("; ")
    plain = argument.lstrip("-")
    return near or (f"write {plain} without dashes" if equals else "estlab run --hydra-help lists them")


def is_sweep(flags: Sequence[str], words: Sequence[str]) -> bool:
    """Whether these make a sweep."""
    mode = any(re.fullmatch(r"\+*hydra\.mode=.*MULTIRUN.*", word) for word in words)
    return mode or bool({"-m", "--multirun"} & set(flags))


def _check_choice(word: str) -> None:
    """A group's choice is a name, or names in a list; Hydra's own words for what is none name no key."""
    key, _, value = word.partition("=")
    if key.lstrip("+").partition("@")[0] not in groups():
        return
    for name in re.split(r"[\[\],]", value):
        if _NO_NAME.fullmatch(name) or re.match(r"\s*\[\s*\[", value):
            raise UserError(f"{word}: write the name of one (see estlab list)")


def _check_size(word: str) -> None:
    """Hydra's parsers call themselves for each bracket, and take ever longer."""
    key, _, value = word.partition("=")
    brackets = value if not is_path(key) else "".join(re.findall(r"\$\{|\}", value))
    depth = deepest = 0
    for sign in brackets:
        depth += (sign in "[{(") - (sign in "]})")
        deepest = max(deepest, depth)
    if deepest > _DEEPEST:
        raise UserError(f"{word[:40]}...: brackets lie more than {_DEEPEST} deep; no key has such a value")
    if re.search(rf"\d{{{_DIGITS}}}", brackets):
        raise UserError(f"{word[:40]}...: is too large a number")


def _expectations(arguments: list[str]) -> list[str]:
    """expect.rmse.x=[0.1,0.2] as what Hydra takes for it: a key that may be new, and a value that merges with none."""
    written: list[str] = []
    for argument in arguments:
        match = re.fullmatch(r"\+{0,2}(expect(?:\.[^=]+)?)=(.*)", argument, re.DOTALL)
        words = [argument]
        if argument == "~expect" or re.fullmatch(r"\+{0,2}expect=\s*(null|\{\s*\})?\s*", argument):
            words = ["expect=null", "expect_files=null"]
        elif match is not None:
            key, value = match.groups()
            words = [f"++{key}=null"] * value.lstrip().startswith(("[", "{")) + [f"++{key}={value}"]
        # What was written so before stays as it is.
        written += words[1:] if written[-1:] == words[:1] else words
    return written


def _file_names(arguments: list[str]) -> list[str]:
    """data.files.truth=mine.mat as what Hydra takes for it: a key that is new."""
    return [re.sub(r"^\+{0,2}(data\.files\.[^=]+=)", r"++\1", argument) for argument in arguments]


def _check_installed(argument: str) -> None:
    if argument.lstrip("+") not in _NEEDS:
        return
    module, extra = _NEEDS[argument.lstrip("+")]
    if importlib.util.find_spec(module.partition(".")[0]) is None or importlib.util.find_spec(module) is None:
        raise UserError(f"{argument} needs more: pip install 'estlab[{extra}]'")


def _several_filters(arguments: list[str]) -> list[str]:
    """filter=[ekf,ukf] as what Hydra takes for it: each in a place of its own under filters."""
    written: list[str] = []
    for argument in arguments:
        group, equals, choice = argument.lstrip("+").partition("=")
        if group == "scenario" and choice.startswith("["):
            raise UserError(
                f"{argument}: a run has one scenario; estlab sweep scenario=car,field takes several in turn"
            )
        if group != "filter" or not equals or (choice and "[" not in choice):
            written.append(argument)
            continue
        names = re.fullmatch(r"\[\s*((?!null\b)[\w./-]+(?:\s*,\s*(?!null\b)[\w./-]+)*)\s*\]", choice)
        several = re.split(r"\s*,\s*", names[1]) if names else []
        if not several or len(several) != len(set(several)):
            raise UserError(
                f"{argument}: name each filter once in one list, as filter=[ekf,ukf]; lists cannot be swept"
            )
        written += [f"filter={several[0]}", *(f"+filter@filters.{name}={name}" for name in several)]
        written.append(f"hydra.job.name={'-'.join(several)}")
    return written
