"""What may go is listed; what goes is that alone, with --yes, inside the folder of runs."""

import fcntl
import json
import os
import platform
import re
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.rundir import process

GONE = 2**22 + 1  # a process number that Linux gives to none


@pytest.fixture(autouse=True)
def _with_a_folder_of_runs(_in_an_empty_folder):
    Path("runs").mkdir()


def run(name: str, status: str, days: float = 0.0, **more: object) -> Path:
    """A run directory whose run ended so many days ago."""
    folder = Path("runs") / name
    (folder / "plots").mkdir(parents=True)
    (folder / "plots/errors.png").write_bytes(b"0" * 1000)
    stamp = datetime.fromtimestamp(time.time() - 86400 * days, UTC).isoformat()
    record = {"status": status, "began": stamp, "pid": GONE, "node": platform.node()}
    if status != "running":
        record["ended"] = stamp
    (folder / "status.json").write_text(json.dumps(record | more))
    return folder


def listed(capsys, *words: str) -> list[str]:
    """The directories that are listed, below runs/."""
    assert main(["clean", *words]) == 0
    return re.findall(r"^runs/(\S+)", capsys.readouterr().out, re.MULTILINE)


def test_a_run_that_found_what_was_not_expected_is_evidence_and_stays(capsys):
    run("new", "unmet", 9, error="1 of 3 expectations not met: diverged expected 0, found 2")
    run("old", "failed", 9, error="1 of 1 expectation not met: diverged expected 0, found 2")  # as it was called once
    run("broken", "failed", error="internal error")
    assert listed(capsys, "--yes") == ["broken"]
    assert sorted(path.name for path in Path("runs").iterdir()) == ["new", "old"]
    run("young", "unmet")
    assert listed(capsys, "--failed") == []
    assert listed(capsys, "--older-than", "2d") == ["new", "old"]


def test_without_yes_nothing_is_deleted_and_all_that_failed_is_listed_with_size_age_and_why(capsys):
    run("d/1", "ok")
    run("d/2", "failed", 2)
    run("d/3", "interrupted", 1)
    run("d/4", "running", 0.1)
    before = sorted(Path("runs").rglob("*"))
    assert main(["clean"]) == 0
    lines = [re.split(r"  +", line.rstrip()) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        ["directory", "size", "age", "status", "why"],
        ["runs/d/2", "0.0 MB", "2 d", "failed", "failed"],
        ["runs/d/3", "0.0 MB", "1 d", "interrupted", "interrupted"],
        ["runs/d/4", "0.0 MB", "2 h", "unfinished", "unfinished"],
        ["3 directories, 0.0 MB; add --yes to delete them"],
    ]
    assert sorted(Path("runs").rglob("*")) == before


def test_yes_deletes_what_is_listed_empty_days_with_it_and_latest_points_to_what_is_left(capsys):
    run("2026-01-01/a", "failed")
    kept = run("2026-01-02/b", "ok", 3)
    run("2026-01-02/c", "interrupted")
    run("2026-01-03/verify/x", "failed")
    Path("runs/latest").symlink_to("2026-01-02/c")
    assert main(["clean", "--yes"]) == 0
    assert "deleted 3 of 3 directories" in capsys.readouterr().out
    assert sorted(path.name for path in Path("runs").iterdir()) == ["2026-01-02", "latest"]
    assert Path("runs/latest").resolve() == kept.resolve()
    assert main(["clean", "--yes", "--older-than", "1h"]) == 0
    assert list(Path("runs").iterdir()) == []
    assert main(["clean", "--yes"]) == 0
    assert "nothing to delete in runs" in capsys.readouterr().out


def test_what_is_at_work_may_be_or_cannot_be_read_stays_and_is_said(capsys):
    stays = [
        run("a", "running", **process.marks()),
        run("b", "running", namespace="another container"),
        run("c", "running", node="another machine"),
        run("d", "running", pid=None),
        run("e", "done"),
        run("f", "failed"),
    ]
    (stays[5] / "status.json").write_text('{"status": "fai')
    assert main(["clean", "--yes"]) == 0
    assert main(["clean", "--yes", "--older-than", "0s"]) == 0
    out, err = capsys.readouterr()
    assert all(path.exists() for path in stays)
    assert all(f"estlab: note: {path} stays: " in err for path in stays)
    assert "it is at work, or was on another machine" in err
    assert out.count("nothing to delete") == 2


def test_links_other_files_and_folders_that_hold_runs_stay(capsys):
    outside = Path("outside")
    run("x", "failed").rename(outside)
    Path("runs/link").symlink_to(outside.resolve())
    Path("runs/day").mkdir()
    Path("runs/day/link").symlink_to(outside.resolve())
    nest = run("nest", "failed")
    run("nest/inner", "ok")
    Path("runs/thesis").mkdir()
    Path("runs/thesis/chapter.tex").write_text("mine")
    victim = run("victim", "failed")
    (victim / "data").symlink_to(outside.resolve())
    assert main(["clean", "--yes"]) == 0
    assert not victim.exists()
    assert (outside / "status.json").exists()
    assert (outside / "plots/errors.png").exists()
    assert Path("runs/link").is_symlink()
    assert Path("runs/day/link").is_symlink()
    assert nest.exists()
    assert Path("runs/thesis/chapter.tex").exists()
    assert "runs/nest stays: it holds other runs" in capsys.readouterr().err


def test_conditions_hold_together(capsys):
    for days, status in ((1, "ok"), (2, "failed"), (5, "ok"), (9, "failed"), (20, "ok")):
        run(str(days), status, days)
    assert listed(capsys) == ["2", "9"]
    assert listed(capsys, "--older-than", "4d") == ["5", "9", "20"]
    assert listed(capsys, "--older-than=1.5w") == ["20"]
    assert listed(capsys, "--older-than", "4d", "--failed") == ["9"]
    assert listed(capsys, "--keep-last", "2") == ["5", "9", "20"]
    assert listed(capsys, "--keep-last", "4", "--failed") == []
    assert listed(capsys, "--keep-last", "3", "--older-than", "3d") == ["9", "20"]


def test_a_sweep_goes_whole_by_its_age_alone_and_not_while_it_is_at_work(capsys):
    run("s/0_a", "ok", 9)
    run("s/1_b", "failed", 8)
    Path("runs/s/sweep.json").write_text("{}")
    assert listed(capsys) == []
    assert listed(capsys, "--older-than", "8.5d") == []
    assert listed(capsys, "--older-than", "7d") == ["s"]
    with open("runs/s/.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert listed(capsys, "--older-than", "7d", "--yes") == []
    running = run("s/2_c", "running", pid=os.getpid())
    assert listed(capsys, "--older-than", "0s", "--yes") == []
    (running / "status.json").unlink()
    assert listed(capsys, "--older-than", "7d", "--yes") == ["s"]
    assert not Path("runs/s").exists()


def test_what_cannot_be_deleted_is_said_and_the_others_go(capsys, monkeypatch):
    import estlab.cli.clean

    first, second = run("1", "failed"), run("2", "failed")
    real = estlab.cli.clean.shutil.rmtree

    def rmtree(path):
        if path.name == "1":
            raise PermissionError(13, "Permission denied", str(path))
        real(path)

    monkeypatch.setattr(estlab.cli.clean.shutil, "rmtree", rmtree)
    assert main(["clean", "--yes"]) == 1
    out, err = capsys.readouterr()
    assert err == "estlab: runs/1: cannot be deleted (Permission denied)\n"
    assert "deleted 1 of 2 directories" in out
    assert first.exists()
    assert not second.exists()


def test_a_run_that_begins_between_list_and_deletion_stays(capsys, monkeypatch):
    import estlab.cli.clean

    folder = run("1", "failed")
    real = estlab.cli.clean._size

    def size(path):
        (path / "status.json").unlink()
        (path / "status.json").write_text(
            json.dumps({"status": "running", "began": "", "pid": os.getpid(), "node": platform.node()})
        )
        return real(path)

    monkeypatch.setattr(estlab.cli.clean, "_size", size)
    assert main(["clean", "--yes"]) == 1
    assert capsys.readouterr().err == "estlab: runs/1: changed since it was listed, and stays\n"
    assert folder.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "there is no such folder of runs"),
        (["runs/1"], "is a run or sweep itself"),
        (["runs", "."], "takes one folder of runs"),
        (["--older"], "has no --older"),
        (["--older-than"], "takes a number and s, m, h, d or w"),
        (["--older-than", "7"], "takes a number and s, m, h, d or w"),
        (["--older-than", "-7d"], "takes a number and s, m, h, d or w"),
        (["--keep-last", "0"], "takes a whole number from 1"),
        (["--keep-last", "many"], "takes a whole number from 1"),
    ],
)
def test_a_mistake_is_one_line_and_code_2(words, said, capsys):
    run("1", "failed")
    assert main(["clean", *words, "--yes"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"estlab: [^\n]*{re.escape(said)}[^\n]*\n", err)
    assert Path("runs/1").exists()
