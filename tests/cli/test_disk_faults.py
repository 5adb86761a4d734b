"""Disks, folders and terminals that fail while a run writes: one line says which, and what was whole stays so."""

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.cli.stdio import Guarded
from estlab.experiment import experiment
from estlab.rundir import RunDirectory
from tests.cli.sweeping import TINY, status
from tests.conftest import ROOT

WORDS = ["run", *TINY, "filter=ekf", "plots=false", "hydra.run.dir=run"]
FILES = 20  # as many at least are written in a run


@pytest.fixture
def disk(monkeypatch):
    """A disk that fails from the file of this number on, with this error."""

    def failing(at: int, number: int) -> None:
        written = iter(range(1_000_000))

        replace = os.replace

        def failing_replace(*names: object, **folders: object) -> None:
            if folders.get("src_dir_fd") is not None and next(written) >= at:  # what lies in a run directory
                raise OSError(number, os.strerror(number))
            replace(*names, **folders)

        monkeypatch.setattr(os, "replace", failing_replace)

    return failing


@pytest.mark.parametrize("at", range(0, FILES, 4))
def test_a_disk_that_is_full_at_any_write_is_one_line_and_the_status_says_so(at, disk, capsys):
    disk(at, errno.ENOSPC)
    assert main([*WORDS, "report=false"]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert "run/" in err
    assert "No space left on device; the run is incomplete, free some space, or set output to another disk" in err
    assert (status("run")["status"], status("run")["exit_code"]) == ("failed", 1)
    assert status("run")["error"] in err
    assert not list(Path("run").rglob("*.part"))


def test_a_disk_that_does_not_take_what_was_written_is_one_line_too(monkeypatch, capsys):
    """As one over a network that says so at the end alone."""

    def full(handle: int) -> None:
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    monkeypatch.setattr(os, "fsync", full)
    assert main([*WORDS, "report=false"]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert "Disk quota exceeded; the run is incomplete, free some space, or set output to another disk" in err
    assert (status("run")["status"], status("run")["exit_code"]) == ("failed", 1)


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.EROFS, "set output to another disk"), (errno.EIO, "the disk is failing"), (errno.EMFILE, "ulimit -n")],
)
def test_what_to_do_goes_by_the_error(number, remedy, disk, capsys):
    disk(3, number)
    assert main([*WORDS, "report=false"]) == 1
    assert remedy in capsys.readouterr().err


def test_a_page_that_does_not_fit_is_said_of_a_failed_run_too(disk, capsys):
    disk(3, errno.ENOSPC)
    assert main(WORDS) == 1
    failed, page = capsys.readouterr().err.splitlines()
    assert "the run is incomplete" in failed
    assert re.search(r"run/report.html: No space left on device; the page is missing; draw it later with \S+", page)


def replaced_by_a_link(run: Path) -> None:
    run.rename("moved")
    Path("mine").mkdir()
    run.symlink_to("mine")


def made_again(run: Path) -> None:
    shutil.rmtree(run)
    run.mkdir()


@pytest.mark.parametrize("fault", [shutil.rmtree, made_again, replaced_by_a_link], ids=lambda fault: fault.__name__)
def test_a_run_whose_directory_goes_is_one_line_and_no_file_is_written_elsewhere(fault, monkeypatch, capsys):
    monkeypatch.chdir(Path.cwd())
    write = experiment.write

    def written(*given):
        fault(Path("run"))
        return write(*given)

    monkeypatch.setattr(experiment, "write", written)
    assert main(WORDS) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        "run: was removed or replaced while the run wrote to it; "
        "the run is incomplete, do not move its directory until the run has ended"
    )
    assert not Path("run").exists() or not list(Path("run").iterdir())


def test_a_status_that_cannot_be_written_at_all_is_a_failed_run(monkeypatch, capsys):
    def refuse(self, *_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), "run/status.json")

    monkeypatch.setattr(RunDirectory, "finish", refuse)
    assert main([*WORDS, "report=false"]) == 1
    assert "run/status.json: Read-only file system" in capsys.readouterr().err


def test_an_error_that_names_no_file_is_not_blamed_on_the_directory(monkeypatch, capsys):
    def refuse(*_):
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(experiment, "write", refuse)
    assert main([*WORDS, "report=false"]) == 1
    assert capsys.readouterr().err.startswith("estlab: Resource temporarily unavailable; the traceback is in ")


def test_output_that_fails_goes_nowhere_and_is_remembered():
    with open("/dev/full", "wb", buffering=0) as full:
        guarded = Guarded(full.fileno())
        assert guarded.write(b"lost") == 4
        assert guarded.failure.errno == errno.ENOSPC
        assert guarded.write(b"more") == 4
        assert not guarded.isatty()
    read, write = os.pipe()
    guarded = Guarded(write)
    assert guarded.write(b"all") == 3
    assert guarded.failure is None
    assert os.read(read, 10) == b"all"
    os.close(read)
    assert guarded.write(b"gone") == 4
    assert guarded.failure.errno == errno.EPIPE
    os.close(write)


@pytest.mark.parametrize(
    ("redirected", "code", "said"),
    [
        ("> /dev/full", 1, "estlab: standard output: No space left on device; not all of it was written\n"),
        (">&- <&-", 0, ""),
        ("2>&- | head -n 1 > /dev/null; exit ${PIPESTATUS[0]}", 0, ""),
    ],
)
def test_standard_output_that_is_full_closed_or_left_is_told_from_the_rest(redirected, code, said):
    command = f"{sys.executable} -m estlab list {redirected}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = subprocess.run(["bash", "-c", command], env=environment, stderr=subprocess.PIPE, text=True)
    assert (found.returncode, found.stderr) == (code, said)
