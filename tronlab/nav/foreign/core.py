"""A navigation core outside this process, asked like any other."""

from dataclasses import dataclass
from time import monotonic
from types import TracebackType
from typing import Self

from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.nav.foreign.channel import ChannelError, LateError
from tronlab.nav.foreign.conversation import ask, say
from tronlab.nav.foreign.launch import START_LIMIT_S, Link, explain, make_ready
from tronlab.nav.foreign.messages import Message, MessageError
from tronlab.nav.foreign.transport import StartError
from tronlab.nav.foreign.wording import result_from_message
from tronlab.nav.specs import CoreSpec

MOST_FAILURES = 5
"""In a row and of one kind, after which a core is asked no more."""
_PATIENCE_S = 5.0
"""How long a core that listens may take to come up again after a failure."""


def open_core(
    spec: CoreSpec,
    context: CoreContext,
    *,
    limit_s: float,
    start_limit_s: float = START_LIMIT_S,
) -> "ForeignCore":
    """Give a core that runs elsewhere; it is started when it is asked first.

    Args:
        spec: Where it is, and its settings.
        context: Camera and reference views.
        limit_s: How long it may take for one frame.
        start_limit_s: How long it may take to get ready.
    """
    return ForeignCore(spec, context, limit_s=limit_s, start_limit_s=start_limit_s)


@dataclass(slots=True)
class _Failures:
    """Those since the last answer, of one kind."""

    kind: str = ""
    last: NavigationResult | None = None
    n: int = 0

    def add(self, kind: str, result: NavigationResult) -> None:
        self.n = self.n + 1 if kind == self.kind else 1
        self.kind, self.last = kind, result

    def instead_of_asking(self) -> NavigationResult | None:
        """Give the result of a frame that is not worth asking for, or None."""
        if self.last is None or self.n < MOST_FAILURES:
            return None
        reason = f"not asked, after {self.n} failures in a row: {self.last.reason}"
        return NavigationResult(self.last.status, reason=reason)


class ForeignCore:
    """A program, a socket or a hosted Python class behind the interface of a core.

    Nothing it does is an exception here. After a failure that leaves unknown what it will say next
    it is ended, and started anew for the next frame.
    """

    def __init__(
        self, spec: CoreSpec, context: CoreContext, *, limit_s: float, start_limit_s: float
    ) -> None:
        self._spec = spec
        self._context = context
        self._limit_s = limit_s
        self._start_limit_s = start_limit_s
        self._link: Link | None = None
        self._failures = _Failures()

    @property
    def name(self) -> str:
        """Get the name the scores carry."""
        return self._spec.name

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def locate(self, frame: Frame) -> NavigationResult:
        """Ask for the pose of one image; see ``NavigationCore``."""
        if result := self._failures.instead_of_asking():
            return result
        try:
            link = self._link = self._link or self._start()
        except StartError as error:
            return self._failed("start", NavigationResult("error", reason=f"the core {error}"))
        try:
            begin_s = monotonic()
            answer = ask(link.transport.channel, frame, link.memory, begin_s + 2 * self._limit_s)
            waited_s = monotonic() - begin_s
        except (ChannelError, MessageError) as error:
            return self._failed(type(error).__name__, self._result_of(error, link))
        except BaseException:  # Ctrl-C: an answer on its way must not meet the next frame
            self._end()
            raise
        self._failures = _Failures()
        return self._read(answer, waited_s)

    def reset(self) -> None:
        """Tell it that the next frame is the first of a sequence, if it keeps state."""
        if self._link is None or not self._link.greeting.is_sequential:
            return
        try:
            say(self._link.transport.channel, "reset", limit_s=self._limit_s)
        except ChannelError:
            self._end()  # one that is started anew remembers nothing either

    def close(self) -> None:
        """Say goodbye to it, and end it."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _start(self) -> Link:
        return make_ready(
            self._spec,
            self._context,
            limit_s=self._start_limit_s,
            patience_s=min(_PATIENCE_S, self._start_limit_s),
        )

    def _read(self, answer: Message, waited_s: float) -> NavigationResult:
        if waited_s > self._limit_s:
            late_s = waited_s - self._limit_s
            return NavigationResult(
                "timeout", reason=f"answered {late_s:.3g} s after the limit of {self._limit_s:g} s"
            )
        try:
            return result_from_message(answer, waited_s=waited_s)
        except (ValueError, TypeError, MessageError) as error:
            return NavigationResult("error", reason=f"the core's result cannot be used: {error}")

    def _result_of(self, error: ChannelError | MessageError, link: Link) -> NavigationResult:
        text = explain(error, link.transport)
        if isinstance(error, LateError):
            limit = f"{self._limit_s:g} s"
            return NavigationResult(
                "timeout", reason=f"no answer within {limit}, nor in another {limit}: it {text}"
            )
        return NavigationResult("error", reason=f"the core {text}")

    def _failed(self, kind: str, result: NavigationResult) -> NavigationResult:
        self._end()
        self._failures.add(kind, result)
        return result

    def _end(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.kill()
