"""Files that are either complete or absent."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO


def write_whole(path: Path, write: Callable[[BinaryIO], object], within: int | None = None, sync: bool = True) -> Path:
    """Write a file beside its place and move it there once complete, so that nobody ever sees half of it.

    within: descriptor of the folder to which the path is relative; by default the current folder. A device or a pipe
    that the user names has nothing beside it, and is written directly. sync: whether the file survives a machine that
    fails from now on; waiting for the disk takes a hundred times as long as writing.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if within is None and path.exists() and not path.is_file() and not path.is_dir():
            with open(path, "wb") as stream:
                write(stream)
            return path
        with suppress(FileNotFoundError):
            os.unlink(partial, dir_fd=within)  # left by a killed process that had our number
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with open(os.open(partial, flags, 0o666, dir_fd=within), "wb") as stream:
            write(stream)
            if sync:
                stream.flush()
                os.fsync(stream.fileno())
        os.replace(partial, path, src_dir_fd=within, dst_dir_fd=within)
    except OSError as error:
        # A failed write does not know the file's name, but the user needs it.
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with suppress(OSError):
            os.unlink(partial, dir_fd=within)
    return path


def write_text(path: Path, text: str) -> Path:
    """:func:`write_whole` for text."""
    return write_whole(path, lambda stream: stream.write(text.encode()))
