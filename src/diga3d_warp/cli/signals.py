"""SIGINT and SIGTERM at any moment: unwind, and end after a while even where nothing unwinds.

A handler of Python runs between two lines of Python. A process that is busy in compiled code for minutes, as
when COLMAP maps, would not end before; so a thread watches for signals, too. Ending at once loses nothing: a
run folder is whole at any moment.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

GRACE = 3.0
"""Seconds that unwinding may take: temporary folders are deleted, and files that are half-written."""

EXIT_SIGNAL = 128
"""Added to a signal's number, it is the exit code by which shells know that the signal ended a program."""

WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Stopped(KeyboardInterrupt):
    """A signal asks the program to end.

    Attributes:
        number: Of the signal.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = signal.Signals(number)


def exit_code(stop: Stopped) -> int:
    """The exit code of a program that a signal ended."""
    return EXIT_SIGNAL + stop.number


def last_line(stop: Stopped, hint: str) -> str:
    """What to say at the end; it begins on a line of its own, below a progress bar."""
    return f"\ndiga3d: {WORDS[stop.number]}{hint}"


@contextmanager
def stoppable(hint: str) -> Iterator[list[Stopped]]:
    """Raise `Stopped` in the block at SIGINT and SIGTERM; end the process if that takes longer than `GRACE`.

    A second signal ends it at once. Signals that the process was started to ignore stay ignored. In other
    threads than the main one, which alone may handle signals, nothing changes.

    Args:
        hint: What the last line says besides, where there is no unwinding.

    Yields:
        What was raised: a library may turn it into an error of its own.
    """
    raised: list[Stopped] = []
    if threading.current_thread() is not threading.main_thread():
        yield raised
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raised.append(Stopped(number))
        raise raised[-1]

    before = {number: signal.getsignal(number) or signal.SIG_DFL for number in WORDS}
    ours = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    reading, writing = socket.socketpair()
    writing.setblocking(False)
    watcher = threading.Thread(target=_watch, args=(reading, hint), daemon=True, name="signals")
    watcher.start()
    woken = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
    ignored, sys.unraisablehook = sys.unraisablehook, _unless_stopped(sys.unraisablehook)
    for number in ours:
        signal.signal(number, stop)
    try:
        yield raised
    finally:
        for number in ours:
            signal.signal(number, before[number])
        signal.set_wakeup_fd(woken)
        sys.unraisablehook = ignored
        writing.close()
        watcher.join()
        reading.close()


def _unless_stopped(hook: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let `hook` report what Python cannot raise, but for `Stopped`: the watcher ends the process."""

    def report(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, Stopped):
            hook(unraisable)

    return report


def _watch(reading: socket.socket, hint: str) -> None:
    """Wait for a signal, then for another, for the end of the block, or for `GRACE`; end the process."""
    number = 0
    while number not in WORDS:
        received = reading.recv(1)
        if not received:
            return
        number = received[0]
    reading.settimeout(GRACE)
    with suppress(TimeoutError):
        while received := reading.recv(1):
            if received[0] in WORDS:
                break
        else:
            return
    with suppress(OSError, ValueError):
        print(last_line(Stopped(number), hint), file=sys.stderr, flush=True)
    os._exit(EXIT_SIGNAL + number)
