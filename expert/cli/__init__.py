"""The command line."""

from expert.cli.main import main

__all__ = ["main"]
