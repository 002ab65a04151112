"""The command line."""

from __future__ import annotations

import sys

INTERRUPTED = 130  # exit code of programs that SIGINT ended


def main() -> None:
    """Run the command line; an interrupt ends it with a word and exit code 130, however early it comes."""
    try:
        from expert.cli.commands import run_command

        run_command()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(INTERRUPTED)


__all__ = ["main"]
