"""What a core is, asked before it is scored."""

import shlex
from dataclasses import dataclass

from tronlab.errors import ScoreError
from tronlab.nav.foreign.identity import digest_of_command
from tronlab.nav.foreign.launch import START_LIMIT_S, greet
from tronlab.nav.foreign.transport import StartError
from tronlab.nav.specs import CoreSpec


@dataclass(frozen=True, slots=True)
class CoreDescription:
    """What a core says of itself, and what its answers depend on."""

    name: str
    """The core's own; the scores carry that of the spec."""
    version: str
    is_sequential: bool
    """Whether it keeps state, and has to see whole sequences."""
    wants_references: bool
    identity: str
    """Changes whenever the answers may: of code, arguments and files; not of settings and seed."""


def describe_core(spec: CoreSpec, *, limit_s: float = START_LIMIT_S) -> CoreDescription:
    """Start or reach a core, ask what it is, and say goodbye.

    Args:
        spec: The core.
        limit_s: How long that may take; not the limit for a frame.

    Raises:
        ScoreError: It cannot be started or reached, or does not speak the protocol.
    """
    try:
        link = greet(spec, limit_s=limit_s)
    except StartError as error:
        raise ScoreError(f"navigation core '{spec.name}': it {error}") from error
    link.close()
    greeting = link.greeting
    files = digest_of_command(shlex.split(spec.target)) if spec.kind == "command" else spec.target
    return CoreDescription(
        name=greeting.name,
        version=greeting.version,
        is_sequential=greeting.is_sequential,
        wants_references=greeting.wants_references,
        identity="\n".join((spec.kind, files, greeting.name, greeting.version, greeting.identity)),
    )
