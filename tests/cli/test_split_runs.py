"""sweep.split_runs: a job's blocks of runs as jobs of their own, put together to the same bytes."""

import logging
import shutil
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.experiment import experiment
from tests.cli.sweeping import rows, status, sweep, table, wait_for
from tests.cli.test_engines import dask
from tests.cli.test_sweep_faults import started

pytestmark = pytest.mark.slow

# Seven blocks a job, of which the first holds the four runs that are kept.
WORDS = ["scenario=field", "runs=21", "steps=10", "block_runs=3", "keep_runs=4", "plots=false"]
THREE = "sweep.split_runs=3"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep whose jobs are not split."""
    folder = tmp_path_factory.mktemp("whole") / "swept"
    assert main(["sweep", *WORDS, "filter=ekf,ukf", f"sweep.dir={folder}"]) == 0
    return folder


def split_sweep(*words: str, place: str = "swept") -> int:
    return main(["sweep", *WORDS, "filter=ekf,ukf", THREE, f"sweep.dir={place}", *words])


@pytest.fixture(scope="module")
def in_parts(tmp_path_factory):
    """The same in parts."""
    folder = tmp_path_factory.mktemp("parts") / "swept"
    assert split_sweep(place=str(folder)) == 0
    return folder


def assert_same_figures(whole: Path, other: Path) -> None:
    names = {path.name for path in whole.iterdir() if path.suffix in (".csv", ".npz")}
    assert {"metrics.csv", "errors.csv", "nis.csv", "tests.csv", "histograms.csv", "estimates.npz"} <= names
    for name in names:
        assert (whole / name).read_bytes() == (other / name).read_bytes(), name


def parts(place: str = "swept") -> list[str]:
    return sorted(str(path.parent.relative_to(place)) for path in Path(place).glob("parts/*/*/status.json"))


def test_a_job_in_parts_has_the_bytes_of_the_job_that_ran_whole(whole, capsys):
    assert split_sweep() == 0
    for job in ("0_field_ekf", "1_field_ukf"):
        assert_same_figures(whole / job, Path("swept") / job)
    assert table() == table(str(whole))
    assert parts() == [f"parts/{job}/{i}-of-3" for job in ("0_field_ekf", "1_field_ukf") for i in range(3)]
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "2 ok" in captured.out
    assert "parts=" not in Path("swept/0_field_ekf/overrides.yaml").read_text(), "the job can be typed without them"


@dask
def test_parts_on_dask_workers_have_the_same_bytes(whole):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=logging.CRITICAL
    ) as cluster:
        assert split_sweep("hydra/launcher=dask", f"hydra.launcher.address={cluster.scheduler_address}") == 0
    for job in ("0_field_ekf", "1_field_ukf"):
        assert_same_figures(whole / job, Path("swept") / job)
    assert len({status(f"swept/{part}")["pid"] for part in parts()}) == 2


def test_runs_over_one_recording_are_split_too():
    assert main(["simulate", "scenario=epuck", "data.path=made"]) == 0
    words = ["sweep", "scenario=epuck", "filter=ekf", "data=files", "runs=10", "steps=30", "plots=false"]
    words += ["data.path=made", "block_runs=3", "keep_runs=2"]
    assert main([*words, "sweep.dir=whole"]) == 0
    assert main([*words, "sweep.dir=split", "sweep.split_runs=4"]) == 0
    assert_same_figures(Path("whole/0_epuck_ekf"), Path("split/0_epuck_ekf"))


@pytest.fixture
def failing(monkeypatch):
    """Make one part of three of the EKF fail; what it returns mends it."""
    real = experiment.run

    def run(settings, *others):
        if settings.part == [1, 3] and settings.names.filter == "ekf":
            raise ZeroDivisionError("one over nothing")
        return real(settings, *others)

    monkeypatch.setattr(experiment, "run", run)
    return lambda: monkeypatch.setattr(experiment, "run", real)


def test_a_failed_part_fails_its_job_alone_and_a_resumed_sweep_runs_that_part_alone(whole, failing, capsys):
    assert split_sweep("sweep.retries=1") == 3
    captured = capsys.readouterr()
    failed = "parts/0_field_ekf/1-of-3"
    assert captured.out.count(f"failed: {failed}: ") == 1
    assert "1 ok, 1 failed" in captured.out
    assert [row["status"] for row in table()] == ["failed", "ok"]
    found = rows("swept/failures.csv")
    assert [(row["job"], row["attempt"]) for row in found] == [(failed, "1"), (failed, "2")]
    assert all("one over nothing" in row["error"] for row in found)
    before = {part: Path("swept", part, "status.json").read_bytes() for part in parts()}
    failing()
    assert split_sweep("sweep.retries=1") == 0
    assert "1 of 2 jobs and 2 of 3 parts of the others are done, the others will run" in capsys.readouterr().err
    assert [part for part, was in before.items() if Path("swept", part, "status.json").read_bytes() != was] == [failed]
    assert_same_figures(whole / "0_field_ekf", Path("swept/0_field_ekf"))
    assert table() == table(str(whole))


def test_after_a_failed_part_fail_fast_begins_no_other(failing):
    assert split_sweep("sweep.fail_fast=true") == 1
    assert parts() == [f"parts/0_field_ekf/{i}-of-3" for i in (0, 1)]
    assert [row["status"] for row in table()] == ["failed", "left"]


@pytest.mark.parametrize("moment", ["parts/0_field_ekf/1-of-3", "1_field_ukf"])
def test_a_split_sweep_that_is_killed_and_resumed_has_the_bytes_of_one_that_was_not(moment, whole):
    process = started(*WORDS, "filter=ekf,ukf", THREE, "sweep.dir=swept")
    wait_for(lambda: Path("swept", moment).exists())
    process.kill()
    process.communicate()
    assert main(["sweep", "--resume", "swept"]) == 0
    for job in ("0_field_ekf", "1_field_ukf"):
        assert_same_figures(whole / job, Path("swept") / job)
    assert table() == table(str(whole))


@pytest.mark.parametrize("spoil", ["cut", "emptied", "flipped", "encrypted", "gone"])
def test_a_part_that_cannot_be_read_runs_again(spoil, whole, in_parts, capsys):
    shutil.copytree(in_parts, "swept")
    part = Path("swept/parts/0_field_ekf/2-of-3/part.npz")
    content = part.read_bytes()
    middle = len(content) // 2  # inside of an array
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    header = content.index(b"PK\x01\x02")  # of the first array in the archive's table, whose flags are 8 bytes on
    encrypted = content[: header + 8] + bytes([content[header + 8] | 1]) + content[header + 9 :]
    changed = {"cut": content[:-500], "emptied": b"", "flipped": flipped, "encrypted": encrypted, "gone": None}[spoil]
    if changed is None:
        part.unlink()
    else:
        part.write_bytes(changed)
    shutil.rmtree("swept/0_field_ekf")
    capsys.readouterr()
    assert split_sweep() == 0
    assert "parts/0_field_ekf/2-of-3: part.npz cannot be read; it runs again" in capsys.readouterr().err
    assert Path("swept/attempts/parts/0_field_ekf/2-of-3.1").is_dir()
    assert_same_figures(whole / "0_field_ekf", Path("swept/0_field_ekf"))


def test_what_parts_a_sweep_has_is_no_part_of_what_it_finds(whole, capsys):
    """It may be resumed whole, or in another number of parts, and needs the parts no more once a job is ok."""
    shutil.copytree(whole, "swept")
    shutil.rmtree("swept/1_field_ukf")
    assert split_sweep() == 0
    assert table() == table(str(whole))
    shutil.rmtree("swept/parts")
    capsys.readouterr()
    assert split_sweep() == 0
    assert "2 of 2 jobs are done, nothing is left to run" in capsys.readouterr().err
    shutil.rmtree("swept/0_field_ekf")
    assert split_sweep("sweep.split_runs=2") == 0
    assert parts() == [f"parts/0_field_ekf/{i}-of-2" for i in range(2)]
    assert table() == table(str(whole))


def test_parts_with_a_limit_on_time_have_the_same_figures(whole):
    assert split_sweep("sweep.timeout=300") == 0
    assert table() == table(str(whole))


def test_there_are_no_more_parts_than_blocks_and_one_line_says_so(whole, capsys):
    assert split_sweep("sweep.split_runs=16") == 0
    err = capsys.readouterr().err
    assert err == (
        "estlab: sweep.split_runs=16: 2 jobs run in 7 parts, one for each block of block_runs runs; "
        "a lower block_runs makes more\n"
    )
    assert len(parts()) == 14
    assert table() == table(str(whole))
    assert sweep("sweep.split_runs=4", place="small") == 0
    assert "0_landmark_ukf runs in 1 part, one for each block" in capsys.readouterr().err
    assert not Path("small/parts").exists()


def test_a_dry_run_counts_the_parts(capsys):
    assert split_sweep("--dry-run") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 jobs in 6 parts, 2 to run"
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("part=[0,2]", "part=[0,2]: a sweep splits its jobs itself; write sweep.split_runs=16 instead"),
        ("parts=[a,b]", "parts=[a,b]: a sweep splits its jobs itself"),
        ("sweep.split_runs=0", "sweep.split_runs must be from 1 to 1e4, got 0"),
    ],
)
def test_parts_cannot_be_typed_in_a_sweep(word, message, capsys):
    assert split_sweep(word) == 2
    assert message in capsys.readouterr().err
    assert not Path("swept").exists()


def test_a_wrong_value_is_said_by_its_own_job():
    assert split_sweep("noise.filter.process_scale=1,-1") == 3
    assert [row["status"] for row in table()] == ["ok", "failed", "ok", "failed"]
    assert {row["job"] for row in rows("swept/failures.csv")} == {"1_field_ekf", "3_field_ukf"}


def test_parts_that_are_all_there_are_put_together_and_not_run_again(whole, in_parts):
    shutil.copytree(in_parts, "swept")
    before = {part: Path("swept", part, "status.json").read_bytes() for part in parts()}
    for job in ("0_field_ekf", "1_field_ukf"):
        shutil.rmtree(f"swept/{job}")
    assert split_sweep() == 0
    assert {part: Path("swept", part, "status.json").read_bytes() for part in parts()} == before
    assert table() == table(str(whole))
