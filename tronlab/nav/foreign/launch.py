"""From a core's spec to a core that runs and has said hello."""

import os
import shlex
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import monotonic, sleep

from tronlab.nav.core import CoreContext
from tronlab.nav.foreign.channel import ChannelError, GoneError, LateError
from tronlab.nav.foreign.conversation import Greeting, say, say_hello, set_up, shared_frame
from tronlab.nav.foreign.messages import MessageError, StrayBytesError
from tronlab.nav.foreign.process import CoreProcess
from tronlab.nav.foreign.shared_memory import SharedFrame
from tronlab.nav.foreign.tcp import CoreSocket
from tronlab.nav.foreign.transport import StartError, Transport, UnreachableError
from tronlab.nav.specs import CoreSpec

START_LIMIT_S = 120.0
"""How long a core may take from its start to being ready for the first frame."""
_CONNECT_LIMIT_S = 10.0
_BYE_LIMIT_S = 0.5
_PAUSE_S = 0.1
_HOST = "tronlab.nav.foreign.host"


@dataclass(frozen=True, slots=True)
class Link:
    """A core that runs, and what it said of itself."""

    transport: Transport
    greeting: Greeting
    memory: SharedFrame | None = None

    def close(self) -> None:
        """Say goodbye."""
        try:
            say(self.transport.channel, "bye", limit_s=_BYE_LIMIT_S)
        except (ChannelError, MessageError):
            self.kill()
        else:
            self.transport.close()
            self._release()

    def kill(self) -> None:
        """End it at once."""
        self.transport.kill()
        self._release()

    def _release(self) -> None:
        if self.memory is not None:
            self.memory.close()


def greet(spec: CoreSpec, *, limit_s: float) -> Link:
    """Start or reach a core, and exchange greetings.

    Raises:
        StartError: It cannot be started or reached, or does not greet.
    """
    transport = _start(spec, limit_s)
    deadline = monotonic() + limit_s  # from here: how long we take to start it is not its fault
    with _killed_on_failure(transport, limit_s):
        greeting = say_hello(transport.channel, spec.settings, spec.seed, deadline)
    return Link(transport, greeting)


def make_ready(
    spec: CoreSpec, context: CoreContext, *, limit_s: float, patience_s: float = 0.0
) -> Link:
    """Start or reach a core, and prepare it for its first frame.

    Args:
        spec: The core.
        context: What it may know.
        limit_s: How long it may take.
        patience_s: How long to try again where nobody listens: the core may be on its way up.

    Raises:
        StartError: It cannot be started or reached, or does not get ready.
    """
    deadline = monotonic() + limit_s
    link = _greet_patiently(spec, limit_s=limit_s, patience_s=patience_s)
    if link.transport.can_share_memory:
        link = replace(link, memory=shared_frame(context, link.greeting))
    with _killed_on_failure(link, limit_s):
        set_up(link.transport.channel, context, link.greeting, link.memory, deadline=deadline)
    return link


def explain(error: ChannelError | MessageError, transport: Transport) -> str:
    """Say in words what went wrong with a core; completes "the core ..."."""
    text = str(error)
    if isinstance(error, StrayBytesError):
        text = f"{text} {transport.stray_bytes_hint}"
    how = transport.how_it_ended() if isinstance(error, GoneError) else ""
    words = transport.last_words()
    said = f"its last words: {words}" if words else ""
    return "; ".join(part for part in (text, how, said) if part)


@contextmanager
def _killed_on_failure(core: Link | Transport, limit_s: float) -> Generator[None]:
    """End a core that does not get started, and say why as a ``StartError``."""
    transport = core.transport if isinstance(core, Link) else core
    try:
        yield
    except LateError as error:
        reason = f"is not ready within {limit_s:g} s: it {explain(error, transport)}"
        core.kill()
        raise StartError(reason) from error
    except (ChannelError, MessageError) as error:
        reason = explain(error, transport)
        core.kill()
        raise StartError(reason) from error
    except BaseException:  # Ctrl-C too
        core.kill()
        raise


def _greet_patiently(spec: CoreSpec, *, limit_s: float, patience_s: float) -> Link:
    given_up = monotonic() + patience_s
    while True:
        try:
            return greet(spec, limit_s=limit_s)
        except UnreachableError:
            if monotonic() >= given_up:
                raise
            sleep(_PAUSE_S)


def _start(spec: CoreSpec, limit_s: float) -> Transport:
    if spec.kind == "tcp":
        return CoreSocket(spec.target, limit_s=min(limit_s, _CONNECT_LIMIT_S))
    if spec.kind == "command":
        return CoreProcess(shlex.split(spec.target))
    # What can be imported here can be imported there.
    variables = {"PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)}
    return CoreProcess([sys.executable, "-m", _HOST, spec.target], variables=variables)
