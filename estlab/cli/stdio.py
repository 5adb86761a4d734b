"""Standard output and error that may be closed, full or gone, as when a terminal closes. That must not end any work."""

import errno
import io
import os
import sys
from typing import Any


class Guarded(io.RawIOBase):
    """A descriptor to write to. It remembers the first failure and discards later output."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self.failure: OSError | None = None

    def write(self, content: Any) -> int:
        if self.failure is None:
            try:
                return os.write(self._descriptor, content)
            except OSError as error:
                self.failure = error
        return len(content)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return self.failure is None and os.isatty(self._descriptor)


class StandardStreams:
    """The process's standard streams, guarded unless somebody replaced them, as a test does."""

    def __init__(self) -> None:
        """A closed descriptor is opened to the null device, or the next file that is opened would get its number."""
        for descriptor in range(3):
            try:
                os.fstat(descriptor)
            except OSError:
                os.open(os.devnull, os.O_RDWR)
        self._out = Guarded(1)
        if sys.stdout is sys.__stdout__:
            encoding = getattr(sys.stdout, "encoding", "utf-8")
            if sys.stdout is not None:
                sys.stdout.flush()
            # A terminal that lacks the middle dot shows another character.
            sys.stdout = io.TextIOWrapper(
                io.BufferedWriter(self._out), encoding, errors="replace", line_buffering=self._out.isatty()
            )
        if sys.stderr is sys.__stderr__:
            encoding = getattr(sys.stderr, "encoding", "utf-8")
            sys.stderr = io.TextIOWrapper(
                io.BufferedWriter(Guarded(2)), encoding, errors="backslashreplace", line_buffering=True
            )

    def failure(self) -> str:
        """Why part of standard output was not written; empty if all was, or if its reader, as head, had seen enough."""
        try:
            sys.stdout.flush()
        except OSError as error:
            self._out.failure = self._out.failure or error
        found = self._out.failure
        return "" if found is None or found.errno == errno.EPIPE else str(found.strerror)
