"""Tells a command how the run goes; whatever becomes of the command, the run never waits for it."""

import os
import queue
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tronlab.campaign.config import NotifyConfig, NotifyEvent

_FAREWELL_S = 5.0
"""So long the end of a run waits for what was not told yet."""
_N_WAITING = 50
"""More than so many are not kept: a command that is slower than events come is told no more."""


@dataclass(frozen=True, slots=True)
class _News:
    """Something to tell."""

    event: NotifyEvent
    text: str
    n_taken: int
    n_planned: int


class Notifier:
    """Runs the command for each event, one after the other and in a thread of its own.

    Use it as a context manager: leaving it waits a few seconds for the last event.
    """

    def __init__(
        self,
        config: NotifyConfig | None,
        *,
        campaign: str,
        dataset: Path,
        warn: Callable[[str], None],
        farewell_s: float = _FAREWELL_S,
    ) -> None:
        """Make a notifier.

        Args:
            config: The command; None: nobody is told.
            campaign: Name of the campaign.
            dataset: Path of the dataset.
            warn: Told, once, that the command fails; maybe from another thread.
            farewell_s: How long the end waits for it.
        """
        self._config = config
        self._campaign = campaign
        self._dataset = dataset
        self._warn = warn
        self._farewell_s = farewell_s
        self._has_warned = False
        self._last: tuple[NotifyEvent, str] | None = None
        self._news: queue.Queue[_News | None] = queue.Queue(_N_WAITING)
        self._thread = threading.Thread(target=self._work, name="tronlab notify", daemon=True)

    def __enter__(self) -> Self:
        """Begin to tell."""
        if self._config is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for what is not told yet, but not long."""
        if self._config is None:
            return
        if self._news.full():  # whoever is so slow is told the last event rather than the first
            with suppress(queue.Empty):
                self._news.get_nowait()
        self._news.put_nowait(None)
        self._thread.join(self._farewell_s)

    def tell(self, event: NotifyEvent, text: str, *, n_taken: int, n_planned: int) -> None:
        """Have the command told, if it wants to know of such events; returns at once.

        The same event with the same text is told once, until something else happens.
        """
        if (event, text) == self._last:
            return
        self._last = event, text
        if self._config is None or event not in self._config.events:
            return
        try:
            self._news.put_nowait(_News(event, text, n_taken, n_planned))
        except queue.Full:
            self._complain(f"is {_N_WAITING} events behind")

    def _work(self) -> None:
        while (news := self._news.get()) is not None:
            self._run_command(news)

    def _run_command(self, news: _News) -> None:
        config = self._config
        if config is None:
            return
        try:
            process = subprocess.Popen(  # noqa: S603  # no shell; the operator wrote it
                config.command,
                env={**os.environ, **self._variables(news)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is meant for the run
            )
        except (OSError, ValueError) as error:
            self._complain(f"cannot be started: {error}")
            return
        try:
            code = process.wait(config.timeout_s)
        except subprocess.TimeoutExpired:
            _kill_with_children(process)
            self._complain(f"took longer than timeout_s of {config.timeout_s:g} s and was ended")
            return
        if code != 0:
            self._complain(f"ended with exit code {code}")

    def _variables(self, news: _News) -> Mapping[str, str]:
        return {
            "TRONLAB_EVENT": news.event,
            "TRONLAB_TEXT": news.text,
            "TRONLAB_CAMPAIGN": self._campaign,
            "TRONLAB_DATASET": str(self._dataset.absolute()),
            "TRONLAB_SHOTS": f"{news.n_taken}/{news.n_planned}",
        }

    def _complain(self, what: str) -> None:
        if self._has_warned or self._config is None:
            return
        self._has_warned = True
        self._warn(
            f"notify.command {self._config.command[0]} {what};"
            " the run goes on, and this is not said again"
        )


def _kill_with_children(process: "subprocess.Popen[bytes]") -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
