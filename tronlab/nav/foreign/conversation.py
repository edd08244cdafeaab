"""What tronlab says to a core and what it understands of the answers: the protocol's order."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from time import monotonic

from tronlab.dataset.records import ReferenceView
from tronlab.nav.core import CoreContext, Frame
from tronlab.nav.foreign.channel import Channel, GoneError
from tronlab.nav.foreign.messages import (
    AnyArray,
    Buffer,
    Message,
    MessageError,
    brief,
    encode,
    quoted,
)
from tronlab.nav.foreign.shared_memory import IS_POSSIBLE, SharedFrame, room_for
from tronlab.nav.foreign.transport import StartError
from tronlab.nav.foreign.wording import Json, camera_to_json, pose_to_json, prior_to_json

PROTOCOL = 1


@dataclass(frozen=True, slots=True)
class Greeting:
    """What a core says of itself."""

    name: str
    version: str
    is_sequential: bool
    wants_references: bool
    can_map: bool
    identity: str


def say_hello(
    channel: Channel, settings: Mapping[str, object], seed: int, deadline: float
) -> Greeting:
    """Exchange greetings.

    Raises:
        StartError: The core speaks another version of the protocol.
        ChannelError: It says nothing.
        MessageError: It says something else.
    """
    hello = {"type": "hello", "protocol": PROTOCOL, "settings": dict(settings), "seed": seed}
    channel.send(encode(hello), deadline)
    header = _receive(channel, {"hello"}, deadline).header
    if header.get("protocol") != PROTOCOL:
        raise StartError(
            f"speaks version {brief(header.get('protocol'))} of the core protocol;"
            f" this tronlab speaks {PROTOCOL}"
        )
    return Greeting(
        name=_text(header, "name", is_needed=True),
        version=_text(header, "version"),
        is_sequential=_flag(header, "sequential"),
        wants_references=_flag(header, "references"),
        can_map=_flag(header, "shared_memory"),
        identity=_text(header, "identity"),
    )


def set_up(
    channel: Channel, context: CoreContext, greeting: Greeting, memory: SharedFrame | None, /,
    *, deadline: float,
) -> None:  # fmt: skip
    """Tell the core camera and reference views, and wait until it is ready.

    Raises:
        StartError: It says that it cannot work with these.
        ChannelError: It says nothing.
        MessageError: It says something else.
    """
    views = context.references if greeting.wants_references else ()
    shared = None if memory is None else {"path": memory.path, "size": memory.size}
    setup: Json = {
        "type": "setup",
        "camera": camera_to_json(context.camera),
        "n_references": len(views),
        "shared_memory": shared,
    }
    channel.send(encode(setup), deadline)
    for index, view in enumerate(views):
        channel.send(_reference(index, view), deadline)
    answer = _receive(channel, {"ready", "failed"}, deadline)
    if answer.kind == "failed":
        raise StartError(f"cannot work here: {_text(answer.header, 'reason') or 'no reason given'}")


def shared_frame(context: CoreContext, greeting: Greeting) -> SharedFrame | None:
    """Make memory for the frames of a core on this machine, if both sides can."""
    if not (greeting.can_map and IS_POSSIBLE):
        return None
    try:
        return SharedFrame(room_for(context.camera.shape))
    except OSError:  # no more memory of this kind: frames go in messages
        return None


def ask(channel: Channel, frame: Frame, memory: SharedFrame | None, deadline: float) -> Message:
    """Send a frame and wait for its result.

    Raises:
        ChannelError: There is no answer, or not in time.
        MessageError: The core spoke unasked, says something else, or answers another frame.
    """
    try:
        unread = channel.unread()
    except GoneError as error:
        raise GoneError("ended after its last answer, before it was asked again") from error
    if unread:
        raise MessageError(f"spoke before it was asked: {quoted(unread)}")
    channel.send(_frame(frame, memory), deadline)
    answer = _receive(channel, {"result"}, deadline)
    number = answer.header.get("number")
    if number != frame.number or isinstance(number, bool):
        raise MessageError(f"answered frame {brief(number)}, asked was {frame.number}")
    return answer


def say(channel: Channel, kind: str, *, limit_s: float) -> None:
    """Send a message that has no keys and no answer.

    Raises:
        ChannelError: The core does not take it.
    """
    channel.send(encode({"type": kind}), monotonic() + limit_s)


def _frame(frame: Frame, memory: SharedFrame | None) -> list[Buffer]:
    header: Json = {
        "type": "frame",
        "number": frame.number,
        "time_s": None if isnan(frame.time_s) else frame.time_s,
        "prior": prior_to_json(frame.prior),
    }
    arrays: dict[str, AnyArray] = {"image": frame.image, "mask": frame.mask}
    parts = memory.put(arrays) if memory is not None else None
    return encode(header, arrays) if parts is None else encode({**header, "parts": parts})


def _reference(index: int, view: ReferenceView) -> list[Buffer]:
    header: Json = {
        "type": "reference",
        "index": index,
        "view_id": view.view_id,
        "pose": pose_to_json(view.trs_from_cam),
    }
    return encode(header, {"image": view.image, "depth_m": view.depth_m, "mask": view.mask})


def _receive(channel: Channel, kinds: set[str], deadline: float) -> Message:
    message = channel.receive(deadline)
    if message.kind not in kinds:
        raise MessageError(
            f"sent a message of type {brief(message.kind)}, expected {' or '.join(sorted(kinds))}"
        )
    return message


def _text(header: Mapping[str, object], key: str, *, is_needed: bool = False) -> str:
    value = header.get(key)
    if isinstance(value, str) and (value or not is_needed):
        return value
    if value is None and not is_needed:
        return ""
    raise MessageError(f"sent {key}: {brief(value)}, must be text")


def _flag(header: Mapping[str, object], key: str) -> bool:
    value = header.get(key)
    if value is None:
        return False
    if not isinstance(value, bool):
        raise MessageError(f"sent {key}: {brief(value)}, must be true or false")
    return value
