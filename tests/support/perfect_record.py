"""A calibration record without errors: what is true of a simulated laboratory."""

from pathlib import Path

import numpy as np

from tronlab.calib.record import IDENTIFIED_DEVICES, CalibrationRecord
from tronlab.campaign.provenance import device_identities
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.truth import build_laboratory


def save_perfect_record(path: Path, *, rig_path: Path) -> Path:
    """Write the record of a rig whose devices are the twin's."""
    rig = load_rig(rig_path)
    assert rig.config.world is not None
    laboratory = build_laboratory(rig.config.laboratory, rig.config.world)
    flat = HeightMap(np.zeros((3, 3), np.float32), 1.0, np.zeros(3))
    devices = rig.open_devices(0, load_heightmap=lambda: flat)
    with connected(devices):
        identities = device_identities(devices)
    CalibrationRecord(
        rig_name=rig.name,
        created_utc="2026-01-01T00:00:00Z",
        software={"tronlab": "test"},
        devices={name: identities[name] for name in IDENTIFIED_DEVICES},
        camera=laboratory.camera,
        camera_covariance=1e-6 * np.eye(9),
        trs_from_trk=laboratory.trk_from_trs.inv(),
        trs_from_trk_covariance=1e-12 * np.eye(6),
        tmac_from_cam=laboratory.flange_from_tmac.inv() * laboratory.flange_from_cam,
        tmac_from_cam_covariance=1e-12 * np.eye(6),
        p_lamp_trs_m=laboratory.p_light_trs_m,
        p_lamp_trs_covariance_m2=1e-6 * np.eye(3),
        statistics={},
        inputs={},
    ).save(path)
    return path
