"""The command line as a person types it, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

MAIN = "from tronlab.cli import main; main()"


def tronlab(*arguments: object, cwd: Path) -> "subprocess.CompletedProcess[str]":
    """Run ``tronlab`` with arguments in a folder; a warning is an error."""
    return subprocess.run(
        [sys.executable, "-c", MAIN, *(str(argument) for argument in arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
        cwd=cwd,
        env={**os.environ, "PYTHONWARNINGS": "error", "MPLBACKEND": "agg"},
    )
