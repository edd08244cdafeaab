"""Sessions in a dataset file: who recorded into it when, and with what."""

from typing import Any, Final

import h5py
import numpy as np

from tronlab.dataset import schema
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.records import Provenance, Session, SessionKind
from tronlab.errors import IntegrityError

_TEXTS: Final = (
    "kind",
    "start_utc",
    "campaign_path",
    "rig_path",
    "calibration_path",
    "campaign_yaml",
    "rig_yaml",
    "calibration_json",
    "plan_sha256",
    "host",
)
_NUMBERS: Final = ("seed", "pid")
_MAPPINGS: Final = ("software", "devices")


def write_session(file: h5py.File, session: Session) -> None:
    """Add a session to a dataset file."""
    sessions = file.require_group(schema.SESSIONS)
    sessions.attrs["NX_class"] = schema.OPTIONAL_GROUPS[schema.SESSIONS]
    group = sessions.create_group(_name(session.number))
    group.attrs["NX_class"] = "NXcollection"
    for name in _TEXTS:
        group[name] = getattr(session, name)
    for name in _NUMBERS:
        number = group.create_dataset(name, data=np.int64(getattr(session, name)))
        number.attrs["units"] = "1"
    for name in _MAPPINGS:
        mapping = group.create_group(name)
        mapping.attrs["NX_class"] = "NXcollection"
        mapping.attrs.update(getattr(session, name))
    if session.accepted:
        group.attrs["accepted"] = list(session.accepted)


def has_session(file: h5py.File, number: int) -> bool:
    """Tell whether a dataset file names a session."""
    return f"{schema.SESSIONS}/{_name(number)}" in file


def read_sessions(file: Hdf5Reader) -> tuple[Session, ...]:
    """Read the sessions of a dataset file; empty if it does not name any.

    Raises:
        IntegrityError: Something is missing or damaged.
    """
    if schema.SESSIONS not in file:
        return ()
    names = sorted(file.names(schema.SESSIONS))
    if names != [_name(number) for number in range(1, len(names) + 1)]:
        raise IntegrityError(f"{file.path}: {schema.SESSIONS} has gaps: {', '.join(names)}")
    return tuple(_session(file, number) for number in range(1, len(names) + 1))


def only_session(provenance: Provenance, *, start_utc: str, kind: SessionKind = "run") -> Session:
    """Give the session of a dataset that was recorded in one, and does not name it."""
    return Session(
        number=1,
        kind=kind,
        start_utc=start_utc,
        campaign_path="",
        rig_path="",
        calibration_path="",
        campaign_yaml=provenance.campaign_yaml,
        rig_yaml=provenance.rig_yaml,
        calibration_json=provenance.calibration_json,
        plan_sha256=provenance.plan_sha256,
        seed=provenance.seed,
        software=provenance.software,
        devices=provenance.devices,
        host="",
        pid=0,
        accepted=provenance.accepted,
    )


def _session(file: Hdf5Reader, number: int) -> Session:
    path = f"{schema.SESSIONS}/{_name(number)}"
    values: dict[str, Any] = {name: file.text(f"{path}/{name}") for name in _TEXTS}
    values |= {name: int(file.read(f"{path}/{name}")) for name in _NUMBERS}
    values |= {name: file.texts(f"{path}/{name}") for name in _MAPPINGS}
    accepted = tuple(map(str, file.attributes(path).get("accepted", ())))
    return Session(number=number, accepted=accepted, **values)


def _name(number: int) -> str:
    return f"{number:04d}"
