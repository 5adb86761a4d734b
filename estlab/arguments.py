"""A command line before Hydra sees it: what Hydra would take wrongly or say badly."""

import importlib.util
import re

from estlab.errors import UserError
from estlab.given import other_data

_FLAGS = {
    *("--help", "-h", "--hydra-help", "--version", "--cfg", "-c", "--resolve", "--package", "-p", "--run", "-r"),
    *("--multirun", "-m", "--shell-completion", "-sc", "--config-path", "-cp", "--config-name", "-cn"),
    *("--config-dir", "-cd", "--info", "-i"),
}
_WITH_VALUE = {"--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"}

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
    """The arguments as Hydra takes them.

    Raises UserError for a flag that there is not, for an output that is no folder, and for a class outside Hydra in
    Hydra's own configuration.
    """
    for i, argument in enumerate(arguments):
        if argument.startswith("-") and argument.partition("=")[0] not in _FLAGS:
            plain = argument.lstrip("-")
            hint = f"write {plain} without dashes" if "=" in plain else "estlab run --hydra-help lists them"
            raise UserError(f"there is no flag {argument}; {hint}")
        if argument in _WITH_VALUE and i + 1 == len(arguments):
            raise UserError(f"{argument} takes a value")
        if re.fullmatch(r"output=(null|\[.*|\{.*|''|\"\"|)", argument):
            raise UserError(f"{argument}: output must be a folder, for example output=runs")
        if (match := re.match(r"[+~]*hydra\..*_target_=(.*)", argument)) and not match[1].startswith("hydra"):
            raise UserError(f"{argument} is refused: Hydra's own classes are hydra's")
        _check_installed(argument)
    return _of_a_sweep(_of_other_data(_file_names(_expectations(_several_filters(arguments)))))


def _of_a_sweep(arguments: list[str]) -> list[str]:
    """In a sweep, what is typed alone is expected: a file's expectations are of its own values, not of those swept.

    Nor has each job a page, if none is asked for.
    """
    sweep = any(re.fullmatch(r"-m|--multirun|\+*hydra\.mode=.*MULTIRUN.*", argument) for argument in arguments)
    return _with_defaults(arguments, ["expect=null", "expect_files=null", "report=false"]) if sweep else arguments


def _of_other_data(arguments: list[str]) -> list[str]:
    """Of an experiment on a recording instead, neither what its file expects nor its number of runs holds.

    What it expects of that recording, under expect_files, does.
    """
    experiment = any(argument.startswith("+experiment=") for argument in arguments)
    other = experiment and other_data(arguments)
    return _with_defaults(arguments, ["expect=null", "runs=1"]) if other else arguments


def _with_defaults(arguments: list[str], keys: list[str]) -> list[str]:
    """The keys before the first that is typed, which adds to them: Hydra takes no flag between keys."""
    first = next((i for i, argument in enumerate(arguments) if re.match(r"[^-].*=|~", argument)), None)
    return arguments if first is None else [*arguments[:first], *keys, *arguments[first:]]


def _expectations(arguments: list[str]) -> list[str]:
    """expect.rmse.x=[0.1,0.2] as what Hydra takes for it: a key that may be new, and a value that merges with none."""
    written: list[str] = []
    for argument in arguments:
        match = re.fullmatch(r"\+{0,2}(expect(?:\.[^=]+)?)=(.*)", argument, re.DOTALL)
        if argument == "~expect" or re.fullmatch(r"\+{0,2}expect=\s*(null|\{\s*\})?\s*", argument):
            written += ["expect=null", "expect_files=null"]
        elif match is None:
            written.append(argument)
        else:
            key, value = match.groups()
            written += [f"++{key}=null"] * value.lstrip().startswith(("[", "{")) + [f"++{key}={value}"]
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
