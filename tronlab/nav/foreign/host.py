"""A Python core in a process of its own, behind the core protocol.

    python -m tronlab.nav.foreign.host package.module:Class
    python -m tronlab.nav.foreign.host akaze-refined --listen 127.0.0.1:5555

The second one serves whoever connects, one after the other, until Ctrl-C.
"""

import argparse
import os
import socket
import sys
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from inspect import isclass
from math import nan
from typing import Any, cast, get_type_hints

import numpy as np

from tronlab.dataset.records import ReferenceView
from tronlab.errors import ScoreError, TronlabError
from tronlab.geometry.camera import CameraModel
from tronlab.nav.answers import checked
from tronlab.nav.core import CoreContext, Frame, NavigationCore, NavigationResult
from tronlab.nav.foreign.channel import FOREVER, Channel, Ends, GoneError
from tronlab.nav.foreign.conversation import PROTOCOL
from tronlab.nav.foreign.identity import digest_of_sources
from tronlab.nav.foreign.installed import Factory, HostedCore, load_core
from tronlab.nav.foreign.messages import AnyArray, Message, MessageError, encode
from tronlab.nav.foreign.shared_memory import MappedFrame
from tronlab.nav.foreign.tcp import tune
from tronlab.nav.foreign.wording import (
    Json,
    pose_from_json,
    prior_from_json,
    result_to_json,
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve a core on standard input and output, or on a socket."""
    parser = argparse.ArgumentParser(
        prog="python -m tronlab.nav.foreign.host",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("core", help="package.module:Class, or the name of an installed core")
    parser.add_argument("--listen", metavar="HOST:PORT", help="serve whoever connects; port 0: any")
    options = parser.parse_args(arguments)
    try:
        # Before the core is imported: what it prints then must not get among the messages.
        streams = _take_standard_streams()
        if options.listen is None:
            serve(Channel(streams), load_core(options.core))
        else:
            _listen(load_core(options.core), options.listen, announce_on=streams.writing)
    except TronlabError as error:
        raise SystemExit(str(error)) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def serve(channel: Channel, hosted: HostedCore) -> None:
    """Speak the core's side of the protocol with one tronlab, until it says goodbye or is gone."""
    with suppress(GoneError):
        hello = channel.receive(FOREVER).header
        _answer(channel, _greeting(hosted))
        setup = channel.receive(FOREVER)
        if setup.kind == "bye":
            return
        context = _context(channel, setup, hello)
        try:
            core, memory = _build(hosted.factory, context), _map(setup)
        except Exception as error:  # whatever it is: tronlab is told
            traceback.print_exc()
            _answer(channel, {"type": "failed", "reason": f"{type(error).__name__}: {error}"})
            return
        _answer(channel, {"type": "ready"})
        _serve_frames(channel, core, memory)


def _serve_frames(channel: Channel, core: NavigationCore, memory: MappedFrame | None) -> None:
    while (message := channel.receive(FOREVER)).kind != "bye":
        if message.kind == "reset":
            cast(Any, core).reset()
        elif message.kind == "frame":
            frame = _frame(message, memory)
            header, arrays = result_to_json(_locate(core, frame), frame.number)
            channel.send(encode(header, arrays), FOREVER)
        else:
            raise MessageError(f"a message of type {message.kind!r} is not known")


def _locate(core: NavigationCore, frame: Frame) -> NavigationResult:
    try:
        return checked(core.locate(frame))
    except Exception as error:  # a shot that the core cannot do; others it can
        traceback.print_exc()
        return NavigationResult("error", reason=f"{type(error).__name__}: {error}")


def _greeting(hosted: HostedCore) -> Json:
    sources = {hosted.module, hosted.factory.__module__} & sys.modules.keys()
    return {
        "type": "hello",
        "protocol": PROTOCOL,
        "name": hosted.name,
        "version": str(getattr(sys.modules[hosted.module], "__version__", "")),
        "sequential": _says_it_is_sequential(hosted.factory),
        "references": True,
        "shared_memory": True,
        "identity": digest_of_sources(*sorted(sources)),
    }


def _says_it_is_sequential(factory: Factory) -> bool:
    """Say whether what it makes keeps state, before it is made: by its class."""
    product: object = factory
    if not isclass(factory):
        product = None
        with suppress(NameError, TypeError, AttributeError):  # hints that cannot be resolved
            product = get_type_hints(factory).get("return")
    return callable(getattr(product, "reset", None))


def _build(factory: Factory, context: CoreContext) -> NavigationCore:
    core = factory(context)
    if not callable(getattr(core, "locate", None)):
        raise ScoreError(f"it made a {type(core).__name__}, which has no method locate(frame)")
    if callable(getattr(core, "reset", None)) and not _says_it_is_sequential(factory):
        raise ScoreError(
            f"it made a {type(core).__name__}, which has reset() and so keeps state, but that must"
            f" be known before: write '-> {type(core).__name__}' behind the factory's arguments"
        )
    return core


def _context(channel: Channel, setup: Message, hello: Mapping[str, Any]) -> CoreContext:
    views = [_view(channel.receive(FOREVER)) for _ in range(setup.header["n_references"])]
    return CoreContext(
        CameraModel.from_dict(setup.header["camera"]),
        tuple(views),
        settings=hello["settings"],
        seed=hello["seed"],
    )


def _view(message: Message) -> ReferenceView:
    arrays = message.arrays()
    return ReferenceView(
        view_id=message.header["view_id"],
        trs_from_cam=pose_from_json(message.header["pose"]),
        image=arrays["image"],
        depth_m=arrays["depth_m"],
        mask=arrays["mask"].astype(np.bool_),
    )


def _map(setup: Message) -> MappedFrame | None:
    shared = setup.header["shared_memory"]
    return None if shared is None else MappedFrame(shared["path"], shared["size"])


def _frame(message: Message, memory: MappedFrame | None) -> Frame:
    arrays: dict[str, AnyArray] = message.arrays(None if memory is None else memory.data)
    time_s = message.header["time_s"]
    # Copies: a core may keep what it was given, and the memory is used again.
    return Frame(
        image=arrays["image"].copy(),
        mask=arrays["mask"].astype(np.bool_),
        number=message.header["number"],
        time_s=nan if time_s is None else time_s,
        prior=prior_from_json(message.header["prior"]),
    )


def _answer(channel: Channel, header: Json) -> None:
    channel.send(encode(header), FOREVER)


def _take_standard_streams() -> Ends:
    """Keep standard input and output for messages, and give everybody else others."""
    ends = Ends(os.dup(0), os.dup(1))
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    cast(Any, sys.stdout).reconfigure(line_buffering=True)
    return ends


def _listen(hosted: HostedCore, address: str, *, announce_on: int) -> None:
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) >= 1 << 16:
        raise ScoreError(f"--listen {address}: write HOST:PORT, port 0 to 65535")
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    try:
        server = socket.create_server((host.strip("[]"), int(port)), family=family)
    except OSError as error:
        raise ScoreError(f"--listen {address}: {error.strerror}") from error
    with server:
        os.write(announce_on, f"tcp://{host}:{server.getsockname()[1]}\n".encode())
        while True:
            connection, _peer = server.accept()
            tune(connection)
            with connection:
                _serve_one(connection, hosted)


def _serve_one(connection: socket.socket, hosted: HostedCore) -> None:
    """Serve one connection; whatever happens on it, the next one is served."""
    try:
        serve(Channel(Ends(connection.fileno(), connection.fileno())), hosted)
    except Exception:
        traceback.print_exc()


if __name__ == "__main__":
    main()
