"""JSON text of a calibration record: written for people to read, read with every mistake named."""

import json
from collections.abc import Sequence
from dataclasses import fields as dataclass_fields
from typing import Any, NoReturn, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import CalibrationError, ConfigError, FrameError
from tronlab.geometry.camera import N_DISTORTION, CameraModel
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat
from tronlab.render.photometry import Photometry
from tronlab.yaml_models import Model, parse_mapping

_SYMMETRY_TOLERANCE = 1e-9


def format_json(value: Any) -> str:
    """Give JSON text with one line for each list of plain values: a matrix row, a point, a pose.

    Raises:
        CalibrationError: A number is not finite, or a value is none JSON has.
    """
    try:
        return _format(value, "") + "\n"
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"calibration record: cannot be written: {error}") from error


def parse_json(text: str, source: str) -> dict[str, Any]:
    """Read JSON text whose top level is a mapping.

    Raises:
        CalibrationError: It is not JSON, or not a mapping; the message has line and column.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(
            f"calibration record {source}:{error.lineno}: not JSON: {error.msg} (column"
            f" {error.colno});\nmake a new record: tronlab calibrate"
        ) from error
    if not isinstance(value, dict):
        raise CalibrationError(
            f"calibration record {source}: the top level is a {type(value).__name__},"
            " expected a mapping;\nmake a new record: tronlab calibrate"
        )
    return cast("dict[str, Any]", value)


class _Surface(Model):
    function: Photometry


class Fields:
    """Typed access to nested plain values; a key is written with dots, as ``lamp.p_trs_m``."""

    def __init__(self, values: dict[str, Any], source: str) -> None:
        self._values = values
        self._source = source

    def check_schema(self, schema: str, version: int) -> None:
        """Refuse what is no record, and a record of a schema this version does not know.

        Raises:
            CalibrationError: Wrong schema, or another version of it.
        """
        if self.get("schema") != schema:
            self._fail("schema", f"is {self.get('schema')!r}, expected {schema!r}")
        found = self.get("schema_version")
        if not isinstance(found, int) or found < 1:
            self._fail("schema_version", f"is {found!r}, expected {version}")
        if found != version:
            raise CalibrationError(
                f"calibration record {self._source}: schema_version: is {found}, this tronlab reads"
                f" {version};\n{'update tronlab, or ' if found > version else ''}make a new record:"
                " tronlab calibrate all --rig RIG.yaml"
            )

    def get(self, key: str) -> Any:
        """Give the value of a key.

        Raises:
            CalibrationError: There is none.
        """
        value: Any = self._values
        for part in key.split("."):
            if not isinstance(value, dict) or part not in value:
                self._fail(key, "missing")
            value = cast("dict[str, Any]", value)[part]
        return value

    def has(self, key: str) -> bool:
        """Tell whether there is a top-level key."""
        return key in self._values

    def text(self, key: str) -> str:
        """Give a text that is not empty."""
        value = self.get(key)
        if not isinstance(value, str) or not value:
            self._fail(key, f"is {value!r}, expected a text")
        return value

    def one_of(self, key: str, allowed: Sequence[str]) -> str:
        """Give a text that is one of those allowed."""
        value = self.text(key)
        if value not in allowed:
            self._fail(key, f"is '{value}', expected one of {', '.join(allowed)}")
        return value

    def optional_number(self, key: str) -> float | None:
        """Give a number, or None if it says so."""
        return None if self.get(key) is None else float(self.array(key, shape=()))

    def mapping(self, key: str) -> dict[str, Any]:
        """Give a mapping."""
        value = self.get(key)
        if not isinstance(value, dict):
            self._fail(key, f"is a {type(value).__name__}, expected a mapping")
        return cast("dict[str, Any]", value)

    def identities(self, key: str, *, needed: Sequence[str]) -> dict[str, DeviceIdentity]:
        """Give identities of devices, at least of the ``needed`` ones."""
        parts = [field.name for field in dataclass_fields(DeviceIdentity)]
        for name in needed:
            self.mapping(f"{key}.{name}")
        return {
            name: DeviceIdentity(*(texts[part] for part in parts))
            for name in self.mapping(key)
            for texts in (self.texts(f"{key}.{name}", needed=parts),)
        }

    def texts(self, key: str, *, needed: Sequence[str] = ()) -> dict[str, str]:
        """Give a mapping of texts that has at least the ``needed`` keys."""
        values = self.mapping(key)
        for name in needed:
            self.get(f"{key}.{name}")
        for name, value in values.items():
            if not isinstance(value, str):
                self._fail(f"{key}.{name}", f"is {value!r}, expected a text")
        return values

    def array(self, key: str, *, shape: tuple[int, ...]) -> FloatArray:
        """Give finite numbers of that shape."""
        value = self.get(key)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            self._fail(key, f"is not numbers of shape {shape}")
        if array.shape != shape:
            self._fail(key, f"has shape {array.shape}, expected {shape}")
        if not np.isfinite(array).all():
            self._fail(key, "has values that are not finite")
        return array

    def covariance(self, key: str, *, n: int) -> FloatArray:
        """Give a covariance matrix, shape (n, n): symmetric, no negative variance."""
        matrix = self.array(key, shape=(n, n))
        scale = np.sqrt(np.abs(np.diag(matrix)))
        if (np.abs(matrix - matrix.T) > _SYMMETRY_TOLERANCE * np.outer(scale, scale)).any():
            self._fail(key, "is not symmetric, so it is no covariance")
        if (np.diag(matrix) < 0).any():
            self._fail(key, "has a negative variance")
        return matrix

    def pose(self, key: str, *, parent: str, child: str) -> RigidTransform:
        """Give the pose ``parent_from_child``."""
        frames = self.text(f"{key}.parent"), self.text(f"{key}.child")
        if frames != (parent, child):
            self._fail(key, f"is {frames[0]}_from_{frames[1]}, expected {parent}_from_{child}")
        numbers = self.array(f"{key}.xyz_m_quat_xyzw", shape=(7,))
        try:
            return pose_from_xyz_quat(numbers, tolerance=1e-9)
        except FrameError as error:
            self._fail(f"{key}.xyz_m_quat_xyzw", str(error))

    def camera(self, key: str) -> CameraModel:
        """Give a camera model."""
        values = self.mapping(key)
        for name in values:
            self.array(f"{key}.{name}", shape=(N_DISTORTION,) if name == "distortion" else ())
        try:
            return CameraModel.from_dict(values)
        except CalibrationError as error:
            self._fail(key, str(error))

    def photometry(self, key: str) -> Photometry:
        """Give the photometric function in a part of that name."""
        values = {"function": self.mapping(f"{key}.function")}
        try:
            return parse_mapping(values, _Surface, key=key).function
        except ConfigError as error:
            raise CalibrationError(f"calibration record {self._source}: {error}") from error

    def _fail(self, key: str, message: str) -> NoReturn:
        raise CalibrationError(
            f"calibration record {self._source}: {key}: {message};"
            "\nmake a new record: tronlab calibrate"
        )


def _format(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        items = cast("dict[str, Any]", value).items()
        lines = [f"{inner}{json.dumps(key)}: {_format(item, inner)}" for key, item in items]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, list | dict) for item in value):
        lines = [inner + _format(item, inner) for item in cast("list[Any]", value)]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)
