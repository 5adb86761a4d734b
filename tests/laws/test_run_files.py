"""Below a directory that may be anybody's, regular files are read and written; all else is refused, never followed."""

import errno
import os
import socket
from pathlib import Path

import pytest

from estlab.datasets.whole import write_whole
from estlab.errors import UserError
from estlab.rundir import RunDirectory, files, link_latest

SECRET = "precious"


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    """A directory of a stranger, beside what it must not touch."""
    monkeypatch.chdir(tmp_path)
    Path("theirs").mkdir()
    Path("mine").mkdir()
    Path("mine/file").write_text(SECRET)
    yield Path("theirs")
    assert Path("mine/file").read_text() == SECRET
    assert files.names(Path("mine")) == ["file"]


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


TRAPS = {
    "link": lambda path: path.symlink_to(Path("mine/file").resolve()),
    "link to a folder": lambda path: path.symlink_to(Path("mine").resolve()),
    "link to nowhere": lambda path: path.symlink_to(Path("mine/new").resolve()),
    "link to itself": lambda path: path.symlink_to(path.name),
    "link to a device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "folder": Path.mkdir,
    "socket": bound,
}


@pytest.mark.parametrize("trap", TRAPS)
def test_what_is_no_regular_file_is_neither_read_nor_written_as_it_stands(trap, root):
    TRAPS[trap](root / "it")
    for use in (files.opened, files.in_place):
        with pytest.raises(files.RefusedError) as refused, use(root, "it"):
            pass
        assert refused.value.filename == "theirs/it"
        assert ("link" in refused.value.strerror) == ("link" in trap)
    with pytest.raises(FileExistsError):
        files.create(root, "it", b"x")
    assert files.has(root, "it")
    assert not files.is_file(root, "it")


@pytest.mark.parametrize("trap", TRAPS)
def test_what_stands_in_the_place_of_a_file_is_replaced_and_not_followed(trap, root):
    TRAPS[trap](root / "it")
    if trap == "folder":
        with pytest.raises(IsADirectoryError, match="theirs/it"):
            files.write_text(root, "it", "x")
    else:
        files.write_text(root, "it", "x")
        assert files.read(root, "it", 1) == b"x"
    assert files.names(Path("theirs")) == ["it"]


@pytest.mark.parametrize("trap", [name for name in TRAPS if name != "folder"])
def test_no_folder_on_the_way_is_followed(trap, root):
    TRAPS[trap](root / "way")
    for use in (
        lambda: files.read(root, "way/file", 100),
        lambda: files.write_text(root, "way/file", "x"),
        lambda: files.write_text(root, "way/deep/file", "x"),
        lambda: files.create(root, "way/new", b"x"),
        lambda: files.in_place(root, "way/file").__enter__(),
        lambda: files.remove(root, "way/file"),
        lambda: files.names(root, "way"),
        lambda: RunDirectory(root / "way", root),
        lambda: RunDirectory(root / "way/run", root),
    ):
        with pytest.raises((files.RefusedError, UserError), match=r"(?s)(?=.*theirs/way).*(is a link|is not a folder)"):
            use()
    assert not files.is_file(root, "way/file")


@pytest.mark.parametrize("name", ["../mine/file", "a/../../mine/file", "{here}/mine/file", "no\0name"])
def test_no_name_leads_out(name, root):
    (root / "a").mkdir()
    name = name.format(here=Path.cwd())
    for use in (lambda: files.read(root, name, 100), lambda: files.write_text(root, name, "x")):
        with pytest.raises((OSError, ValueError)):
            use()


def test_a_file_with_a_second_name_elsewhere_is_not_written_as_it_stands(root):
    os.link("mine/file", root / ".lock")
    with pytest.raises(files.RefusedError, match="has another name elsewhere"), files.in_place(root, ".lock"):
        pass


def test_a_file_that_is_too_large_is_not_read(root):
    with open(root / "zeros", "wb") as stream:
        stream.truncate(2**40)  # which take no room
    with pytest.raises(files.RefusedError, match="larger than any file of a run"):
        files.read(root, "zeros", 2**20)


def test_the_users_own_links_above_are_followed(root):
    Path("disk").symlink_to(root.resolve())
    files.write_text(Path("disk"), "run/plots/a.png", "x")
    assert (root / "run/plots/a.png").read_text() == "x"
    directory = RunDirectory(Path("disk/day/run"))
    directory.finish("ok")
    assert '"status": "ok"' in (root / "day/run/status.json").read_text()


def test_the_log_is_not_written_through_a_link(root):
    directory = RunDirectory(root / "run")
    (root / "run/log.txt").symlink_to(Path("mine/file").resolve())
    with pytest.raises(files.RefusedError, match=r"log\.txt"), directory.logged():
        pass
    directory.finish("failed")


@pytest.mark.parametrize("trap", ["link", "folder", "pipe"])
def test_latest_is_made_or_left_and_nothing_is_followed(trap, root):
    TRAPS[trap](root / "latest")
    TRAPS[trap](root / f".latest.{os.getpid()}")
    (root / "day").mkdir()
    link_latest(root / "day", root)
    assert (trap == "link") == (root / "latest").is_symlink(), "what is no link is somebody's, and stays"


@pytest.mark.parametrize("state", ["running", "ok"])
def test_a_full_disk_leaves_the_old_file_or_the_status_in_place(state, root, monkeypatch):
    directory = RunDirectory(root / "run")
    directory.write_text("kept", "whole")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left on device: 'theirs/run/kept'"):
        directory.write_text("kept", "half")
    directory.finish("failed", "the disk is full", 1)
    assert '"status": "failed"' in (root / "run/status.json").read_text()
    assert files.names(Path("theirs/run")) == ["kept", "status.json"]
    assert (root / "run/kept").read_text() == "whole"


@pytest.mark.parametrize("again", [False, True])
def test_a_directory_that_is_removed_is_not_made_again(again, root):
    directory = RunDirectory(root / "run")
    (root / "run/status.json").unlink()
    (root / "run").rmdir()
    if again:
        (root / "run").mkdir()
    for use in (lambda: directory.write_text("x/y", "x"), lambda: directory.finish("ok")):
        with pytest.raises(FileNotFoundError, match="was removed or replaced while the run wrote to it"):
            use()
    assert not directory.is_there()
    assert files.names(Path("theirs")) == ["run"] * again


def test_what_the_user_names_may_be_a_device_or_a_pipe():
    assert write_whole(Path("/dev/null"), lambda stream: stream.write(b"x")) == Path("/dev/null")
    assert Path("/dev/null").is_char_device()


def test_the_disk_is_waited_for_once_for_all_that_was_written(root, monkeypatch):
    directory = RunDirectory(root / "run")
    names, synced = ["run.json", "metrics.csv", "plots/errors.png"], []
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (synced.append(os.fstat(handle).st_ino), sync(handle)))
    for name in names * 2:
        directory.write_text(name, "x")
    assert synced == []
    directory.write_text("gone", "x")
    (root / "run/gone").unlink()
    directory.sync()
    assert sorted(synced) == sorted((root / "run" / name).stat().st_ino for name in names)

    def full(handle: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="Input/output error: 'theirs/run/"):
        directory.sync()
