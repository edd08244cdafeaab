"""Reading from a dataset file where the dataset comes from."""

from dataclasses import fields
from typing import Any

import numpy as np

from tronlab.dataset import schema
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.records import Provenance, Recomputation
from tronlab.errors import CalibrationError, IntegrityError
from tronlab.geometry.camera import CameraModel


def read_provenance(file: Hdf5Reader) -> Provenance:
    """Read the provenance of a dataset file.

    Raises:
        IntegrityError: Something is missing or damaged.
    """
    return Provenance(
        campaign_name=file.text("entry/title"),
        campaign_yaml=file.text("entry/campaign/data"),
        rig_name=file.text("entry/instrument/name"),
        rig_yaml=file.text("entry/rig/data"),
        calibration_json=file.text("entry/calibration/data"),
        seed=int(file.read("entry/recording/seed")),
        software=file.texts("entry/software"),
        devices=file.texts("entry/devices"),
        plan_sha256=file.text("entry/recording/plan_sha256"),
        n_shots_planned=int(file.read(schema.N_SHOTS_PLANNED)),
        camera=_camera_model(file),
        accepted=tuple(map(str, file.attributes("entry/calibration").get("accepted", ()))),
        recomputation=_recomputation(file),
    )


def _recomputation(file: Hdf5Reader) -> Recomputation | None:
    if schema.RECOMPUTED not in file:
        return None
    texts = {
        field.name: file.text(f"{schema.RECOMPUTED}/{field.name}")
        for field in fields(Recomputation)
    }
    return Recomputation(**texts)


def _camera_model(file: Hdf5Reader) -> CameraModel:
    path = f"{schema.CAMERA}/model"
    values: dict[str, Any] = {}
    for name, value in file.attributes(path).items():
        # Text of digits would pass for a number.
        if not isinstance(value, np.generic | np.ndarray) or value.dtype.kind not in "iuf":
            raise IntegrityError(f"{file.path}: {path}: {name} is {value!r}, not a number")
        values[name] = value.tolist()
    try:
        return CameraModel.from_dict(values)
    except (CalibrationError, OverflowError) as error:
        raise IntegrityError(f"{file.path}: {path}: {error}") from error
