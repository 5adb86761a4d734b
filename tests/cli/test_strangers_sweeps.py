"""A sweep's directory from a stranger, resumed, compared and drawn: nothing in it is followed, and nothing hangs."""

import os
import shutil
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.rundir import files
from tests.cli.sweeping import TINY, rows, sweep, table

pytestmark = pytest.mark.slow

JOB = "1_landmark_ekf"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A sweep of two jobs, one of them in two parts."""
    folder = tmp_path_factory.mktemp("undisturbed") / "swept"
    assert main(["sweep", *TINY, "plots=false", "filter=ekf", "seed=1,2", f"sweep.dir={folder}"]) == 0
    return folder


@pytest.fixture
def swept(undisturbed):
    """A copy of it, beside a folder and a file that it must not touch."""
    shutil.copytree(undisturbed, "swept")
    Path("mine").mkdir()
    Path("mine/file").write_text("precious")
    yield Path("swept")
    assert Path("mine/file").read_text() == "precious"
    assert files.names(Path("mine")) == ["file"]


def linked(path: Path, to: str) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.symlink_to(Path(to).resolve())


def piped(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


REFUSED = {
    "lock a link": (lambda s: linked(s / ".lock", "mine/file"), ".lock: is a link"),
    "lock a pipe": (lambda s: piped(s / ".lock"), ".lock: is not a regular file"),
    "lock a second name": (lambda s: ((s / ".lock").unlink(), os.link("mine/file", s / ".lock")), ".lock: has another"),
    "plan a link": (lambda s: linked(s / "sweep.json", "mine/file"), "no readable sweep.json"),
    "plan a pipe": (lambda s: piped(s / "sweep.json"), "no readable sweep.json"),
    "attempts a link": (
        lambda s: ((s / JOB / "metrics.csv").unlink(), linked(s / "attempts", "mine")),
        "attempts: is a link",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_without_following_a_link_is_one_line(case, swept, capsys):
    spoil, said = REFUSED[case]
    spoil(swept)
    capsys.readouterr()
    assert main(["sweep", "--resume", "swept"]) == 2
    err = capsys.readouterr().err
    assert said in err.splitlines()[-1]


def status_piped(swept: Path) -> str:
    piped(swept / JOB / "status.json")
    return "status.json is not a regular file"


def run_piped(swept: Path) -> str:
    piped(swept / JOB / "run.json")
    return "run.json cannot be read"


def metrics_piped(swept: Path) -> str:
    piped(swept / JOB / "metrics.csv")
    return "metrics.csv cannot be read"


def status_a_link(swept: Path) -> str:
    linked(swept / JOB / "status.json", "mine/file")
    return "status.json is a link, which is not followed"


def status_a_folder(swept: Path) -> str:
    (swept / JOB / "status.json").unlink()
    (swept / JOB / "status.json").mkdir()
    return "status.json is not a regular file"


def job_a_link(swept: Path) -> str:
    linked(swept / JOB, "mine")
    return f"{JOB} is a link, which is not followed"


def job_a_file(swept: Path) -> str:
    shutil.rmtree(swept / JOB)
    (swept / JOB).write_text("in the way")
    return f"{JOB} is not a folder"


def others_linked(swept: Path) -> str:
    """Whatever else a job or the sweep writes."""
    (swept / JOB / "metrics.csv").unlink()
    linked(swept / "plots", "mine")
    for name in ("sweep.csv", "failures.csv", "report.html", ".stop"):
        linked(swept / name, "mine/file")
    (swept / ".stop").unlink()
    return "metrics.csv cannot be read"


@pytest.mark.parametrize(
    "spoil",
    [status_piped, run_piped, metrics_piped, status_a_link, status_a_folder, job_a_link, job_a_file, others_linked],
)
def test_a_job_that_is_not_what_it_seems_is_set_aside_and_run_again(spoil, swept, undisturbed, capsys):
    said = spoil(swept)
    capsys.readouterr()
    assert main(["sweep", "--resume", "swept"]) == 0
    err = capsys.readouterr().err
    assert f"job {JOB}: {said}" in err
    assert table() == table(str(undisturbed))
    assert len(rows("swept/failures.csv")) == 1
    assert not (swept / JOB).is_symlink()
    assert os.path.lexists(swept / "attempts" / f"{JOB}.1")


def test_a_plot_is_not_drawn_through_a_link(swept, capsys):
    linked(swept / "plots", "mine")
    assert main(["sweep", "--resume", "swept", "plots=true"]) != 0
    assert "plots: is a link, which is not followed" in capsys.readouterr().out


@pytest.mark.parametrize("is_a_link", [False, True])
def test_no_engine_finds_what_another_left_there(is_a_link, swept):
    """Submitit takes .submitit/<job>/<job>_0_result.pkl for its job's own, and unpickles it."""
    if is_a_link:
        linked(swept / ".submitit", "mine")
    else:
        (swept / ".submitit/1").mkdir(parents=True)
        (swept / ".submitit/1/1_0_result.pkl").write_bytes(b"his")
    assert main(["sweep", "--resume", "swept"]) == 0
    assert not os.path.lexists(swept / ".submitit")
    assert (swept / "attempts/.submitit.1").is_symlink() == is_a_link


def test_a_part_is_not_made_through_a_link(capsys):
    Path("swept").mkdir()
    Path("mine").mkdir()
    Path("swept/parts").symlink_to(Path("mine").resolve())
    words = ["filter=ekf", "seed=1", "block_runs=1", "keep_runs=1", "sweep.split_runs=2"]
    assert sweep(*words) == 2
    assert "sweep.dir must be a sweep's directory or a new one" in capsys.readouterr().err
    Path("swept/parts").unlink()
    assert sweep(*words) == 0
    shutil.rmtree("swept/parts")
    (Path("swept/0_landmark_ekf") / "metrics.csv").unlink()
    Path("swept/parts").symlink_to(Path("mine").resolve())
    assert sweep(*words) == 2
    assert "swept/parts: is a link, which is not followed" in capsys.readouterr().err
    assert files.names(Path("mine")) == []


def test_a_sweep_whose_directory_is_removed_is_not_made_again(swept, monkeypatch, capsys):
    (swept / JOB / "metrics.csv").unlink()
    from estlab.sweeps import state

    aside = state.set_aside

    def removed_too(sweep, name, **options):
        aside(sweep, name, **options)
        if name == JOB:
            shutil.rmtree("swept")

    monkeypatch.setattr(state, "set_aside", removed_too)
    assert main(["sweep", "--resume", "swept"]) == 1
    assert capsys.readouterr().err.endswith("swept: was removed while the sweep wrote to it\n")
    assert not Path("swept").exists() or list(Path("swept").iterdir()) == []
