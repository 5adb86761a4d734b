"""Memory that is short is said in one line, in whatever words the system says it."""

import errno
import resource

import pytest

from estlab.cli.main import main
from estlab.errors import UserError, is_lack_of_memory
from estlab.experiment import experiment
from estlab.parallel import cores

MB = 2**20


@pytest.fixture
def held_to(monkeypatch):
    """Hold this process to so many MB of addresses, as far as it asks."""
    return lambda most: monkeypatch.setattr(resource, "getrlimit", lambda what: (most * MB, most * MB))


@pytest.mark.parametrize("most", [1, 200, 319])
def test_a_limit_too_low_to_import_the_libraries_is_one_line_before_they_are(most, held_to, capsys):
    held_to(most)
    assert main(["run", "scenario=landmark"]) == 2
    assert capsys.readouterr().err == (
        f"estlab: out of memory: estlab run needs 320 MB of address space and this process may use {most}; "
        "raise its limit, for example ulimit -v unlimited\n"
    )
    assert main(["--version"]) == 0


@pytest.mark.parametrize(("what", "enough"), [("estlab run", 320), ("estlab sweep", 440), ("engine=compiled", 500)])
def test_each_command_has_a_limit_of_its_own(what, enough, held_to):
    held_to(enough)
    cores.enough_memory(what)
    held_to(enough - 1)
    with pytest.raises(UserError, match="out of memory"):
        cores.enough_memory(what)


def test_no_limit_is_enough(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda what: (resource.RLIM_INFINITY,) * 2)
    cores.enough_memory("engine=compiled")


LACKS = [
    MemoryError(),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    ImportError("_pocketfft_umath.so: failed to map segment from shared object"),
    ImportError("libx.so: cannot allocate memory in static TLS block"),
]


@pytest.mark.parametrize("error", LACKS, ids=lambda error: type(error).__name__)
def test_a_run_that_meets_its_limit_says_so_and_what_to_lower(error, tmp_path, monkeypatch, capsys):
    def fail(*_):
        raise error

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(experiment, "run", fail)
    assert main(["run", "scenario=landmark", "report=false", "hydra.run.dir=run"]) == 1
    assert capsys.readouterr().err.startswith("estlab: out of memory; lower block_runs")
    monkeypatch.setattr(experiment, "check", fail)
    assert main(["run", "scenario=landmark", "hydra.run.dir=other"]) == 1
    assert capsys.readouterr().err.startswith("estlab: out of memory; ")


@pytest.mark.parametrize("error", [ImportError("no module named x"), OSError(errno.ENOSPC, "full"), ValueError()])
def test_other_errors_are_no_lack_of_memory(error):
    assert not is_lack_of_memory(error)
