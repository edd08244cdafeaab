"""The layout of a dataset file: its version, its groups, and where each value lies.

The layout is NeXus at heart (https://manual.nexusformat.org): groups carry ``NX_class``, the chain
of ``default`` attributes leads a viewer to the images, and every number says its unit (UDUNITS).
``docs/reference/dataset.md`` describes it for people.
"""

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias, get_args

from tronlab.dataset.records import ErrorClass, QualityFlag

SCHEMA_VERSION: Final = (2, 0)
"""Major and minor. A reader refuses a higher major; a higher minor only adds to the layout."""

OLDEST_MAJOR: Final = 1
"""Of the layouts that are still read."""

VERSION_TEXT: Final = ".".join(map(str, SCHEMA_VERSION))
SCHEMA_ATTRIBUTE: Final = "tronlab_schema"

FinalStatus: TypeAlias = Literal["complete", "aborted", "failed"]
Status: TypeAlias = Literal["running", "complete", "aborted", "failed"]
TruthState: TypeAlias = Literal["good", "suspect", "unchecked"]
"""Of a shot: between two good drift checks, beside a bad one, or without one on both sides."""

CAMERA: Final = "entry/instrument/camera"
ROBOT: Final = "entry/instrument/robot"
TRACKER: Final = "entry/instrument/tracker"
ROOM: Final = "entry/instrument/room"
TRUTH: Final = "entry/truth"
N_COMMITTED: Final = "entry/recording/n_committed"
N_SHOTS_PLANNED: Final = "entry/recording/n_shots_planned"
STATUS: Final = "entry/recording/status"
REASON: Final = "entry/recording/reason"
END_TIME: Final = "entry/end_time"
IMAGE: Final = f"{CAMERA}/image"
MASK: Final = f"{CAMERA}/mask"
IMAGE_CRC32: Final = f"{CAMERA}/image_crc32"
MASK_CRC32: Final = f"{CAMERA}/mask_crc32"
VALUES_CRC32: Final = "entry/shots/values_crc32"
SHOT_ID: Final = "entry/shots/shot_id"
SUPERSEDES: Final = "entry/shots/supersedes"
N_FAILURES: Final = "entry/shots/n_failures"
SESSION: Final = "entry/shots/session"
QUALITY: Final = "entry/quality"
QUALITY_FLAGS: Final = f"{QUALITY}/flags"
TIMING: Final = "entry/timing"
UUID: Final = "entry/entry_identifier_uuid"
SESSIONS: Final = "entry/sessions"
SEGMENTS: Final = "entry/segments"
JOURNAL: Final = "entry/journal/data"
"""Only in a packed file: the text of the journal."""
SEGMENT_IMAGE: Final = "entry/data/image"
"""Within the file of a segment; likewise below."""
SEGMENT_MASK: Final = "entry/data/mask"
REFERENCES: Final = "entry/references"
REFERENCES_CRC32: Final = f"{REFERENCES}/crc32"
REFERENCE_VALUES: Final = ("view_id", "trs_from_cam", "image", "depth_m", "mask")
"""Everything of a reference view, in the order its checksum takes it."""
DRIFT: Final = "entry/drift"
N_DRIFT_CHECKS: Final = f"{DRIFT}/n_committed"
DRIFT_SESSION: Final = f"{DRIFT}/session"
DRIFT_CRC32: Final = f"{DRIFT}/crc32"
RECOMPUTED: Final = "entry/recomputed"

POSE_UNITS: Final = ["m", "m", "m", "1", "1", "1", "1"]
"""Of the seven columns."""
COVARIANCE_UNITS: Final = ["rad", "rad", "rad", "m", "m", "m"]
"""Of rows and columns: element (i, j) has the product of units i and j."""
UNIX_TIME: Final = "seconds since 1970-01-01 00:00:00 UTC"
PIXEL_FORMAT_BYTES: Final = 16
QUALITY_FLAG_NAMES: Final[tuple[QualityFlag, ...]] = get_args(QualityFlag)
"""Flag ``i`` is bit ``i``; new ones come at the end."""
ERROR_CLASSES: Final[tuple[ErrorClass, ...]] = get_args(ErrorClass)
"""In the order of their columns; new ones come at the end."""
NO_ROW: Final = -1
VOID_SHOT_ID: Final = -1
"""Of a row that holds no shot: not yet, or not any more, because a power cut damaged it."""
UNKNOWN_FLAG: Final = 255
"""Stands for a yes or no that nobody knows."""

GROUPS: Final[Mapping[str, str]] = {
    "entry": "NXentry",
    "entry/recording": "NXprocess",
    "entry/campaign": "NXnote",
    "entry/rig": "NXnote",
    "entry/calibration": "NXnote",
    "entry/software": "NXcollection",
    "entry/devices": "NXcollection",
    "entry/instrument": "NXinstrument",
    CAMERA: "NXdetector",
    f"{CAMERA}/model": "NXcollection",
    ROBOT: "NXpositioner",
    TRACKER: "NXcollection",
    ROOM: "NXcollection",
    "entry/shots": "NXcollection",
    TRUTH: "NXcollection",
    QUALITY: "NXcollection",
    TIMING: "NXcollection",
    "entry/data": "NXdata",
    "entry/overview": "NXdata",
}
"""Every group of a new file and its NeXus class; ``OPTIONAL_GROUPS`` has those not all need."""

OPTIONAL_GROUPS: Final[Mapping[str, str]] = {
    REFERENCES: "NXcollection",
    DRIFT: "NXcollection",
    SESSIONS: "NXcollection",
    SEGMENTS: "NXcollection",
    "entry/journal": "NXnote",
    RECOMPUTED: "NXprocess",
}
