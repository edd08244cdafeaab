"""Blender in a process of its own, with its own Python: started, asked, ended."""

import json
import os
import queue
import shutil
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, cast

import platformdirs

from tronlab.render.renderer import RenderError

PYTHON_VARIABLE = "TRONLAB_BLENDER_PYTHON"
"""Environment variable: the Python in which ``import bpy`` works."""
SCENE_SCRIPT = Path(__file__).parent / "in_blender" / "scene.py"
START_LIMIT_S = 120.0
_END_LIMIT_S = 2.0
_LONGEST_REPLY = 1 << 16
_LAST_WORDS = 12


def blender_python() -> Path:
    """Give the Python that has Blender.

    Raises:
        RenderError: There is none; the message says how to make it.
    """
    usual = platformdirs.user_data_path("tronlab") / "blender"
    named = os.environ.get(PYTHON_VARIABLE)
    python = Path(named) if named else usual / "bin" / "python"
    if not python.is_file():
        origin = f"{PYTHON_VARIABLE} is" if named else "looked for at"
        raise RenderError(
            f"renderer cycles: Blender's Python is not there: {origin} {python}\n"
            + how_to_make(usual)
        )
    return python


def how_to_make(folder: Path) -> str:
    """Give the commands that make Blender's Python."""
    return (
        "make it (Python 3.11, about 1 GB) with:\n"
        f"  python3.11 -m venv {folder}\n"
        f"  {folder}/bin/pip install 'bpy==5.0.1' 'numpy<2'\n"
        f"or set {PYTHON_VARIABLE} to the python of such an environment"
    )


class BlenderProcess:
    """A running Blender: takes requests and gives replies, one JSON object a line each.

    It ends with this object, with this interpreter and, because its input then closes, with this
    process however that ends. Ctrl-C does not reach it: a request that is broken off ends it.
    """

    def __init__(self, python: Path, script: Path = SCENE_SCRIPT) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="tronlab-blender-"))
        """For files that go with requests; removed at the end."""
        self._log = self.folder / "blender.log"
        self._turn = threading.Lock()
        try:
            self._process = _start(python, script, self.folder, self._log)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise RenderError(f"renderer cycles: {python} does not start: {error}") from error
        self._replies: queue.Queue[str] = queue.Queue()
        reader = threading.Thread(
            target=_read, args=(self._process.stdout, self._replies), daemon=True
        )
        reader.start()
        self._end = weakref.finalize(self, _end, self._process, reader, self.folder)
        self.greeting = self._reply("start", START_LIMIT_S)

    @property
    def has_ended(self) -> bool:
        """Get whether it can be asked no more."""
        return not self._end.alive

    def ask(self, request: Mapping[str, Any], *, what: str, limit_s: float) -> dict[str, Any]:
        """Send a request and wait for the reply.

        Args:
            request: What to do, with numbers, texts, lists and mappings.
            what: The same in words, for errors: "render an image".
            limit_s: How long it may take.

        Raises:
            RenderError: Blender says it cannot, or has ended, or took too long, or answered
                something else than a reply. Except in the first case the process is ended.
        """
        with self._turn:
            # Where it has ended, the missing reply says so, with its last words.
            with suppress(OSError, ValueError):
                _send(self._process.stdin, request)
            return self._reply(what, limit_s)

    def end(self) -> None:
        """End it, whatever it does."""
        self._end()

    def _reply(self, what: str, limit_s: float) -> dict[str, Any]:
        try:
            reply = self._next_reply(what, limit_s)
        except BaseException:  # also Ctrl-C: what is under way must not answer the next request
            self.end()
            raise
        if "error" in reply:
            raise RenderError(f"renderer cycles: Blender could not {what}: {reply['error']}")
        return reply

    def _next_reply(self, what: str, limit_s: float) -> dict[str, Any]:
        try:
            line = self._replies.get(timeout=limit_s)
        except queue.Empty:
            raise self._failure(f"did not {what} within {limit_s:g} s") from None
        if not line:
            self._replies.put("")  # it has ended for whoever asks next, too
            code = _exit_code(self._process)
            raise self._failure(f"ended ({code}) when it should {what}")
        try:
            reply = json.loads(line)
        except ValueError:
            reply = None
        if not isinstance(reply, dict):
            raise self._failure(f"answered {line.strip()[:80]!r} when it should {what}")
        return cast(dict[str, Any], reply)

    def _failure(self, what: str) -> RenderError:
        said: list[str] = []
        with suppress(OSError):  # the log goes with the process
            said = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        lines = [f"renderer cycles: Blender {what}"]
        if said:
            lines += ["its last words:", *(f"  {line}" for line in said[-_LAST_WORDS:])]
        if any("No module named 'bpy'" in line for line in said):
            lines.append(how_to_make(platformdirs.user_data_path("tronlab") / "blender"))
        return RenderError("\n".join(lines))


def _start(python: Path, script: Path, folder: Path, log: Path) -> "subprocess.Popen[str]":
    with log.open("wb") as errors:
        return subprocess.Popen(  # noqa: S603  # no shell; the user named this Python
            # Isolated: neither our own modules nor variables meant for our Python reach it.
            [str(python), "-I", str(script), str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )


def _send(stdin: IO[str] | None, request: Mapping[str, Any]) -> None:
    if stdin is not None:
        stdin.write(json.dumps(request) + "\n")
        stdin.flush()


def _read(stdout: IO[str], replies: "queue.Queue[str]") -> None:
    """Hand on what Blender answers; at its end an empty text."""
    for line in iter(lambda: stdout.readline(_LONGEST_REPLY), ""):
        replies.put(line)
    replies.put("")


def _exit_code(process: "subprocess.Popen[str]") -> str:
    try:
        code = process.wait(_END_LIMIT_S)
    except subprocess.TimeoutExpired:
        return "closed its output"
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _end(process: "subprocess.Popen[str]", reader: threading.Thread, folder: Path) -> None:
    """Close its input, which ends it, or else kill it."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    try:
        process.wait(_END_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    reader.join(_END_LIMIT_S)
    if process.stdout is not None:
        process.stdout.close()
    shutil.rmtree(folder, ignore_errors=True)
