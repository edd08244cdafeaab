"""The command line: one module a command."""

from tronlab.cli.app import main

__all__ = ["main"]
