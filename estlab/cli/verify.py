"""estlab verify: runs the experiments that state their answers, and checks them."""

import argparse
import contextlib
import io
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.cli.parser import CONFIG_FOLDER, Parser
from estlab.config.locations import conf_folder
from estlab.errors import UserError
from estlab.launch import yaml_bounds
from estlab.launch.arguments import CONFIG_DIR
from estlab.launch.commands import run_job
from estlab.launch.given_keys import other_data
from estlab.launch.launcher import FAILED, OK, USAGE, complain, launch, remove_if_ours

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from estlab.config.expectations import Finding


class VerifyOptions(argparse.Namespace):
    """The options of the command line: experiments and keys, and the user's folder of configuration."""

    words: list[str]
    config_dir: Path | None


def parser() -> Parser:
    """The command line of estlab verify."""
    found = Parser(
        "verify",
        "verify [EXPERIMENT ...] [key=value ...] [--config-dir DIR]",
        "Runs every experiment whose file has an expect block, or those that you name,\n"
        "and checks each against it. The runs are side by side below one folder,\n"
        "<output>/<date>/<time>_verify/, without plots and pages. One table at the end\n"
        "shows what was expected and what was found. key=value applies to every run:\n"
        "estlab verify seed=2 tests whether the answers depend on the seed, and\n"
        "estlab verify epuck_smooth data=files data.path=DIR checks what the experiment\n"
        "expects of that recording.",
        "exit codes: 0 all met, 1 some not met or a run failed, 2 usage, 130 interrupted",
    )
    found.add_argument("words", metavar="EXPERIMENT", nargs="*", help="experiments, and keys for every run")
    found.add_argument(*CONFIG_DIR, type=CONFIG_FOLDER, metavar="DIR", help="a folder of your own configuration")
    return found


@dataclass
class ExperimentOutcome:
    """The outcome of one experiment. error: in one line, why there is nothing to check."""

    experiment: str
    findings: "list[Finding]" = field(default_factory=list)
    folder: Path | None = None
    code: int = OK
    error: str = ""

    def __str__(self) -> str:
        met = sum(finding.met for finding in self.findings)
        return f"failed: {self.error}" if self.error else f"{met} of {len(self.findings)} met"


def verify(arguments: list[str]) -> int:
    """Run the requested experiments and print one table. Returns the exit code."""
    names, keys, config_dir = _read(arguments)
    from estlab.report.console import console

    experiments = _chosen(names, experiment_files(config_dir))
    # Flags come before keys, where Hydra expects them.
    before, after = ["--config-dir", str(config_dir)] if config_dir else [], ["plots=false", "report=false", *keys]
    stamp = time.strftime("%Y-%m-%d/%H-%M-%S") + f"-{time.time_ns() // 1000 % 1_000_000:06d}_verify"
    out, outcomes = console(), []
    width = max(map(len, experiments))
    for i, name in enumerate(experiments, 1):
        out.print(f"{i:{len(str(len(experiments)))}} of {len(experiments)}  {name:{width}}  ", end="")
        began = time.monotonic()
        outcomes.append(_run(name, [*before, f"+experiment={name}", *after], stamp))
        out.print(f"{outcomes[-1]}, {time.monotonic() - began:.0f} s", markup=False, soft_wrap=True)
    folder = next((outcome.folder for outcome in outcomes if outcome.folder), None)
    if len({outcome.error for outcome in outcomes}) == 1 and all(outcome.code == USAGE for outcome in outcomes):
        # A mistake on the command line, reported by every run: none began.
        if folder:
            remove_if_ours(folder, folder.parent.parent)
        return complain(outcomes[0].error)
    return _conclude(outcomes, folder)


def experiment_files(config_dir: Path | None) -> dict[str, Path]:
    """Every experiment by its name. A shipped one takes precedence over a user's of that name, as in Hydra."""
    folders = [config_dir, conf_folder()] if config_dir else [conf_folder()]
    return {path.stem: path for folder in folders for path in sorted((folder / "experiment").glob("*.yaml"))}


def _read(arguments: Sequence[str]) -> tuple[list[str], list[str], Path | None]:
    """The experiments named, the keys for every run, and the user's folder of configuration."""
    names: list[str] = []
    keys: list[str] = []
    options = parser().read(arguments, VerifyOptions())
    for word in options.words:
        if word.lstrip("+").startswith(("experiment=", "hydra.")):
            raise UserError(
                f"{word}: estlab verify sets the experiment and the run's directory itself; see estlab verify --help"
            )
        if word == "~expect" or word in ("expect=null", "expect={}"):
            raise UserError(f"{word} leaves nothing to verify")
        (keys if "=" in word or word.startswith("~") else names).append(word)
    return names, keys, options.config_dir


def _chosen(names: Sequence[str], known: dict[str, Path]) -> list[str]:
    """The experiments named, or every one that has expectations."""
    from estlab.config.build import nearest

    for name in names:
        if name not in known:
            raise UserError(f"there is no experiment {name}{nearest(name, list(known))} (see estlab list experiments)")
    chosen = list(dict.fromkeys(names)) or [name for name, path in known.items() if _expects(path)]
    if not chosen:
        raise UserError("no experiment has expectations; add an expect block to one")
    return sorted(chosen)


def _expects(path: Path) -> bool:
    """Whether an experiment's file has expectations. One that cannot be read is run, to report why."""
    from omegaconf import DictConfig, OmegaConf

    try:
        yaml_bounds.checked(path)
        content = OmegaConf.load(path)
    except Exception:
        return True
    return not isinstance(content, DictConfig) or bool(content.get("expect"))


def _run(name: str, words: list[str], stamp: str) -> ExperimentOutcome:
    """Run one experiment in its own directory, without output on the screen."""
    outcome = ExperimentOutcome(name)

    def job(config: "DictConfig") -> int:
        outcome.folder = Path(str(config.output)) / stamp
        return run_job(["estlab", "run", *words], config, outcome.findings.extend)

    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
        try:
            outcome.code = launch([*words, f"hydra.run.dir=${{output}}/{stamp}/{name}"], job)
        except UserError as error:
            outcome.code = complain(str(error))
    if outcome.code == OK and not outcome.findings:
        outcome.code = FAILED
        outcome.error = "it has no expectations" + " of this recording" * other_data(words)
    elif outcome.code != OK and all(finding.met for finding in outcome.findings):
        outcome.error = errors.getvalue().strip().rpartition("\n")[2].removeprefix("estlab: ")
    return outcome


def _conclude(outcomes: Sequence[ExperimentOutcome], folder: Path | None) -> int:
    """Print the table of all experiments and the count. Returns the exit code."""
    from estlab.report import grids
    from estlab.report.console import print_line
    from estlab.report.expected import HEADINGS, expected_grid

    lines = [(o.experiment, *finding.cells()) for o in outcomes for finding in o.findings]
    broken = [o for o in outcomes if o.error]
    lines += [(o.experiment, "", "", "", o.error, grids.FAILED) for o in broken]
    grids.show(expected_grid(("experiment", *HEADINGS), lines))
    findings = [finding for o in outcomes for finding in o.findings]
    met = sum(finding.met for finding in findings)
    count = f"{met} of {len(findings)} expectations met in {len(outcomes)} experiment{'s' * (len(outcomes) > 1)}"
    failed = f"; {len(broken)} run{'s' * (len(broken) > 1)} failed" if broken else ""
    print_line(f"{count}{failed}: {folder or 'no run began'}")
    return (
        OK
        if met == len(findings) and not broken
        else complain(f"some expectations are not met: {count}{failed}", FAILED)
    )
