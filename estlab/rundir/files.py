"""The only way into a directory from anybody: regular files of bounded size, read and written through no link.

A root is a directory that the user named, and links on the way to it are the user's own. Anything below it is
untrusted: each folder on the way down, and the file itself, must be what it seems. No pipe, device or socket is
opened, so none can block. Errors are OSError with the path of the faulty file.
"""

import errno
import os
import stat
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from typing import BinaryIO

from estlab.datasets.whole import write_whole

_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_FILE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC

LINK = "is a link, which is not followed"


class RefusedError(OSError):
    """Something of this name is not a regular file or folder, or is too large; strerror says which."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(errno.EINVAL, why, str(path))


@contextmanager
def folder(root: Path, name: str | PurePath = "", make: bool = False) -> Iterator[int]:
    """A descriptor of a folder below the root, reached through folders only, never through a link.

    make: whether to create missing folders.
    """
    handle, at = os.open(root, _FOLDER), root
    try:
        for part in PurePath(name).parts:
            at /= part
            if part == ".." or "/" in part or "\0" in part:
                raise RefusedError(at, "leads out of the directory")
            if make:
                with suppress(FileExistsError):
                    os.mkdir(part, dir_fd=handle)
            facts = _facts(handle, part, at)
            if not stat.S_ISDIR(facts.st_mode):
                raise RefusedError(at, LINK if stat.S_ISLNK(facts.st_mode) else "is not a folder")
            below = os.open(part, _FOLDER | os.O_NOFOLLOW, dir_fd=handle)
            os.close(handle)
            handle = below
        yield handle
    finally:
        os.close(handle)


@contextmanager
def opened(root: Path, name: str, most: int | None = None) -> Iterator[BinaryIO]:
    """A file opened for reading. most: its maximum number of bytes."""
    with _file(root, name, os.O_RDONLY) as stream:
        if most is not None and os.fstat(stream.fileno()).st_size > most:
            raise RefusedError(root / name, "is larger than any file of a run")
        yield stream


def read(root: Path, name: str, most: int) -> bytes:
    """A file's bytes, up to a maximum number."""
    with opened(root, name, most) as stream:
        return stream.read(most + 1)


def write(root: Path, name: str, write: Callable[[BinaryIO], object], sync: bool = True) -> Path:
    """Write a file whole or not at all; creates folders in its name. An existing file is replaced, not followed.

    sync: whether to wait for the disk; see :func:`sync`.
    """
    path = root / name
    try:
        with folder(root, PurePath(name).parent, make=True) as within:
            write_whole(Path(path.name), write, within, sync)
    except RefusedError:
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    return path


def sync(root: Path, names: Iterable[str]) -> None:
    """Wait until the disk has these files: all at once, since it then has them in one go. Those that are gone are not.

    Raises OSError for the first that the disk does not take.
    """
    failures: list[OSError] = []

    def wait_for(name: str) -> None:
        try:
            with opened(root, name) as stream:
                os.fsync(stream.fileno())
        except (FileNotFoundError, RefusedError):
            pass
        except OSError as error:
            failures.append(OSError(error.errno, error.strerror, str(root / name)))

    threads = [threading.Thread(target=wait_for, args=[name]) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]


def write_text(root: Path, name: str, text: str) -> Path:
    """:func:`write` for text."""
    return write(root, name, lambda stream: stream.write(text.encode()))


def create(root: Path, name: str, content: bytes) -> None:
    """Write a file that must not exist; raises FileExistsError if it does."""
    with folder(root, PurePath(name).parent, make=True) as within:
        handle = os.open(PurePath(name).name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FILE, 0o666, dir_fd=within)
        try:
            with open(handle, "wb") as stream:
                stream.write(content)
        except OSError as error:
            with suppress(OSError):
                os.unlink(PurePath(name).name, dir_fd=within)
            raise OSError(error.errno, error.strerror, str(root / name)) from error


@contextmanager
def in_place(root: Path, name: str) -> Iterator[BinaryIO]:
    """A file to read and write in place, created if needed: for locks, logs, and full disks."""
    with _file(root, name, os.O_RDWR | os.O_CREAT) as stream:
        if os.fstat(stream.fileno()).st_nlink > 1:
            raise RefusedError(root / name, "has another name elsewhere, so it is not written to")
        yield stream


def is_file(root: Path, name: str) -> bool:
    """Whether a regular file has the name."""
    try:
        with folder(root, PurePath(name).parent) as within:
            return stat.S_ISREG(_facts(within, PurePath(name).name, root / name).st_mode)
    except OSError:
        return False


def has(root: Path, name: str) -> bool:
    """Whether anything has the name, even a link to nowhere."""
    try:
        with folder(root, PurePath(name).parent) as within:
            _facts(within, PurePath(name).name, root / name)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return True


def names(root: Path, name: str | PurePath = "") -> list[str]:
    """The content of a folder, sorted."""
    with folder(root, name) as handle, os.scandir(handle) as entries:
        return sorted(entry.name for entry in entries)


def remove(root: Path, name: str) -> None:
    """Remove a file or a link, if it exists."""
    with suppress(FileNotFoundError), folder(root, PurePath(name).parent) as within:
        os.unlink(PurePath(name).name, dir_fd=within)


@contextmanager
def _file(root: Path, name: str, flags: int) -> Iterator[BinaryIO]:
    path = root / name
    with folder(root, PurePath(name).parent) as within:
        try:
            _must_be_regular(_facts(within, path.name, path), path)
        except FileNotFoundError:
            if not flags & os.O_CREAT:
                raise
        try:
            handle = os.open(path.name, flags | _FILE, 0o666, dir_fd=within)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error
    with open(handle, "r+b" if flags & os.O_RDWR else "rb", buffering=0 if flags & os.O_RDWR else -1) as stream:
        _must_be_regular(os.fstat(handle), path)  # the file that was checked may not be the one that was opened
        yield stream


def _must_be_regular(facts: os.stat_result, path: Path) -> None:
    if not stat.S_ISREG(facts.st_mode):
        raise RefusedError(path, LINK if stat.S_ISLNK(facts.st_mode) else "is not a regular file")


def _facts(within: int, name: str, path: Path) -> os.stat_result:
    try:
        return os.stat(name, dir_fd=within, follow_symlinks=False)
    except ValueError as error:
        raise RefusedError(path, "has a zero byte in its name") from error
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
