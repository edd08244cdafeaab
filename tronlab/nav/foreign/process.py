"""A core that is a program: started, listened to, killed with everything it started."""

import errno
import os
import signal
import subprocess
import threading
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os.path import isdir, isfile  # unlike those of pathlib, never an error
from time import monotonic, sleep
from typing import IO

from tronlab.nav.foreign.channel import Channel, Ends
from tronlab.nav.foreign.transport import MAX_ANSWER_SIZE, StartError

_END_LIMIT_S = 1.0
"""How long a program may take to end by itself once its input has ended."""
_DEATH_LIMIT_S = 0.5
"""How long we wait for the exit code of a program that has closed its output."""
_WORDS_LIMIT_S = 0.05
"""How long we wait for the end of standard error, which ends with the program."""
_N_LINES = 12
_LONGEST_LINE = 500
_PIPE_SIZE = 1 << 20
_KILL_GROUP_AT_END_OF_INPUT = 'read _; kill -s KILL -- "-$1"'


class CoreProcess:
    """A running program that speaks the protocol on its standard input and output.

    It has a session of its own, so that Ctrl-C reaches us alone. A shell waits beside it for the
    end of a pipe that only we hold, and then kills its whole process group: so nothing is left
    behind even if we are killed, and the program need not notice that its input has ended.
    """

    can_share_memory = True
    stray_bytes_hint = "to standard output, which carries the messages; print to standard error"

    def __init__(
        self, arguments: Sequence[str], *, variables: Mapping[str, str] | None = None
    ) -> None:
        """Start it.

        Args:
            arguments: Program and arguments; no shell reads them.
            variables: Added to the environment.

        Raises:
            StartError: There is no such program, or it may not be started.
        """
        try:
            self._process = subprocess.Popen(  # noqa: S603  # no shell; the user named it
                list(arguments),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                env={**os.environ, **(variables or {})},
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            hint = _hint(error, arguments)
            raise StartError(
                f"cannot be started: {arguments[0]!r}: {reason}{hint and f'; {hint}'}"
            ) from error
        self._words = _LastWords(_pipe(self._process.stderr))
        watch = _start_watch(self._process)
        self._end = weakref.finalize(self, _end, self._process, watch, self._words)
        stdin, stdout = _pipe(self._process.stdin), _pipe(self._process.stdout)
        _enlarge(stdin)
        self._channel = Channel(Ends(stdout.fileno(), stdin.fileno()), max_payload=MAX_ANSWER_SIZE)

    @property
    def channel(self) -> Channel:
        """Get the stream of messages."""
        return self._channel

    @property
    def pid(self) -> int:
        """Get the process id, which is its process group's as well."""
        return self._process.pid

    def how_it_ended(self) -> str:
        """Give exit code or signal."""
        end = _wait_for_end(self._process.pid, _DEATH_LIMIT_S) if self._end.alive else None
        if end is None:
            return "it still runs"
        if end.si_code == os.CLD_EXITED:
            return f"exit code {end.si_status}"
        return f"signal {end.si_status} ({signal.strsignal(end.si_status)})"

    def last_words(self) -> str:
        """Give the last line on standard error."""
        return self._words.last_line()

    def close(self) -> None:
        """Close its input, wait a moment, then kill it with its children."""
        self._end()

    def kill(self) -> None:
        """Kill it with its children at once."""
        if self._end.alive:
            _kill_group(self._process.pid)
        self._end()


class _LastWords:
    """Reads standard error until its end, so that the program never waits for us, and keeps little.

    A thread, for the pipe fills while nobody waits for an answer as well.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._lines: deque[str] = deque(maxlen=_N_LINES)
        self._thread = threading.Thread(target=self._read, daemon=True, name="core's stderr")
        self._thread.start()

    def last_line(self) -> str:
        self._thread.join(_WORDS_LIMIT_S)
        return next((line for line in reversed(tuple(self._lines)) if line), "")

    def close(self) -> None:
        # A daemon that the program started may hold the pipe: the thread stays with it then.
        self._thread.join(_DEATH_LIMIT_S)

    def _read(self) -> None:
        line = b""
        with self._stream:
            while chunk := self._stream.read(1 << 16):
                *whole, rest = (line + chunk).split(b"\n")
                self._lines.extend(_readable(text) for text in whole)
                line = rest[:_LONGEST_LINE]
            self._lines.append(_readable(line))


def _readable(line: bytes) -> str:
    text = line[:_LONGEST_LINE].decode("utf-8", errors="replace").strip()
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _hint(error: OSError | ValueError, arguments: Sequence[str]) -> str:
    """Say what to do about a program that the system does not start, or nothing."""
    program = arguments[0]
    code = error.errno if isinstance(error, OSError) else None
    is_there = isfile(program)
    beginnings = (" ".join(arguments[:n]) for n in range(2, len(arguments) + 1))
    spaced = next((path for path in beginnings if isfile(path)), "")
    hints = (
        (isdir(program), "it is a folder"),
        (program.startswith("~"), "no shell reads this: write the whole path"),
        (code == errno.EACCES and is_there, f"chmod +x {program}, or name what runs it before it"),
        (
            code == errno.ENOEXEC,
            "it is no program for this machine, nor a script that begins with #!",
        ),
        (is_there and "/" not in program, f"write ./{program}"),
        (code == errno.ENOENT and is_there, "it is there, but not what its first line names"),
        (spaced != "", f"put the name in quotes: cmd:'{spaced}'"),
    )
    return next((hint for holds, hint in hints if holds), "")


def _start_watch(process: "subprocess.Popen[bytes]") -> "subprocess.Popen[bytes]":
    try:
        return subprocess.Popen(  # noqa: S603  # fixed text; the group is a number
            ["/bin/sh", "-c", _KILL_GROUP_AT_END_OF_INPUT, "sh", str(process.pid)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,
        )
    except OSError as error:  # too many processes, say
        _kill_group(process.pid)
        process.wait()
        raise StartError(f"cannot be watched over by /bin/sh: {error.strerror}") from error


def _end(
    process: "subprocess.Popen[bytes]", watch: "subprocess.Popen[bytes]", words: _LastWords
) -> None:
    _pipe(process.stdin).close()
    _wait_for_end(process.pid, _END_LIMIT_S)
    _kill_group(process.pid)
    watch.kill()
    process.wait()
    watch.wait()
    words.close()
    for stream in (process.stdout, watch.stdin):
        _pipe(stream).close()


def _wait_for_end(pid: int, limit_s: float) -> "os.waitid_result | None":
    """Wait until a child has ended, and leave it there: its number stays taken until it is killed.

    Once it were collected, its number might be that of another program's process group.
    """
    pause_s, deadline = 0.0005, monotonic() + limit_s
    while True:
        try:
            end = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG)
        except ChildProcessError:  # somebody else in this process collects every child
            return None
        if end is not None or monotonic() > deadline:
            return end
        sleep(pause_s)
        pause_s = min(2 * pause_s, 0.02)


def _kill_group(group: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, signal.SIGKILL)


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise AssertionError("every stream of a core is a pipe")
    return stream


def _enlarge(stream: IO[bytes]) -> None:
    """Have a pipe hold a whole image, where the system allows: fewer turns for each frame."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl  # not everywhere

        fcntl.fcntl(stream.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
