"""How a person names a core: built in or installed, a Python class, a program, a socket."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Literal, TypeAlias

from tronlab.errors import ScoreError

CoreKind: TypeAlias = Literal["installed", "python", "command", "tcp"]

CORE_NAME = re.compile(r"[A-Za-z0-9_:-][A-Za-z0-9._:@=,+-]*")
"""A core's name is the name of a group in matches.h5, where a slash or a first dot is a path."""
_ALIAS = re.compile(r"([A-Za-z0-9_-][A-Za-z0-9._@+-]*)=(.+)", re.DOTALL)
_PYTHON = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):([A-Za-z_]\w*)")
_TCP = re.compile(r"tcp://(\[[0-9A-Fa-f:.]+\]|[^\s/:\[\]]+):(\d{1,5})/?")


@dataclass(frozen=True)
class CoreSpec:
    """A core to be scored: where it is, under which name, with which settings."""

    name: str
    """The name the scores carry."""
    kind: CoreKind
    target: str
    """Name of the installed core, ``package.module:attribute``, command line, or host:port."""
    settings: Mapping[str, object] = field(default_factory=dict[str, object])
    seed: int = 0


def parse_core(text: str) -> CoreSpec:
    """Read what ``--core`` takes.

    ``NAME``, ``package.module:Class``, ``cmd:PROGRAM ARGUMENTS`` or ``tcp://HOST:PORT``, each with
    ``ALIAS=`` before it if the scores shall carry another name.

    Raises:
        ScoreError: It is none of these, or its name cannot be one.
    """
    alias, source = _split_alias(text.strip())
    kind, target, name = _source(source)
    spec = CoreSpec(alias or name, kind, target)
    if not CORE_NAME.fullmatch(spec.name):
        raise ScoreError(
            f"navigation core {spec.name!r}: its results cannot be filed under this name: a name"
            " has letters, digits and . _ : @ = , + - only, and does not begin with a dot;"
            " give it another: --core my-name=..."
        )
    return spec


def parse_cores(texts: Sequence[str]) -> tuple[CoreSpec, ...]:
    """Read several; the same one twice counts once.

    Raises:
        ScoreError: One cannot be read, or two different ones have the same name.
    """
    specs: dict[str, CoreSpec] = {}
    for text in texts:
        spec = parse_core(text)
        if specs.setdefault(spec.name, spec) != spec:
            raise ScoreError(
                f"two navigation cores are called {spec.name!r}: {specs[spec.name].target} and"
                f" {spec.target}; name one of them: --core other-name={text}"
            )
    return tuple(specs.values())


def _split_alias(text: str) -> tuple[str, str]:
    match = _ALIAS.fullmatch(text)
    return (match[1], match[2].strip()) if match else ("", text)


def _source(source: str) -> tuple[CoreKind, str, str]:
    """Give kind, target and the name it has without an alias."""
    if source.startswith("cmd:"):
        return _command(source.removeprefix("cmd:").strip())
    if source.startswith("tcp:"):
        return _tcp(source)
    if match := _PYTHON.fullmatch(source):
        return "python", source, match[2]
    return "installed", source, source


def _command(command: str) -> tuple[CoreKind, str, str]:
    try:
        arguments = shlex.split(command)
    except ValueError as error:
        raise ScoreError(f"navigation core 'cmd:{command}': {error}") from error
    if not arguments:
        raise ScoreError("navigation core 'cmd:': no program; write cmd:PROGRAM ARGUMENTS")
    return "command", command, PurePath(arguments[0]).stem


def _tcp(source: str) -> tuple[CoreKind, str, str]:
    match = _TCP.fullmatch(source)
    if not match or not 0 < int(match[2]) < 1 << 16:
        raise ScoreError(
            f"navigation core {source!r}: not an address; write tcp://HOST:PORT, port 1 to 65535"
        )
    host, port = match[1].strip("[]"), match[2]
    return "tcp", f"{match[1]}:{port}", f"{host}:{port}"
