"""The command line."""

from __future__ import annotations

import signal
import sys
import threading

INTERRUPTED = 130  # exit code of programs that SIGINT ended

_came = threading.Event()


def main() -> None:
    """Run the command line; an interrupt ends it with a word and exit code 130, however early it comes."""
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _interrupt)
        from expert.cli.commands import run_command

        run_command()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(INTERRUPTED)


def check_interrupt() -> None:
    """Raise the interrupt that came, if a library that was being imported or called back took it for its own error.

    Raises
    ------
    KeyboardInterrupt
        SIGINT came.
    """
    if _came.is_set():
        raise KeyboardInterrupt


def _interrupt(number: int, frame: object) -> None:
    _came.set()
    raise KeyboardInterrupt


__all__ = ["main"]
