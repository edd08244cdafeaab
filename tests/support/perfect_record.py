"""A calibration record without errors: what is true of a simulated laboratory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from records import make_record, make_results

from tronlab.calib.inputs import FrameInput, points_of
from tronlab.campaign.provenance import device_identities
from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.devices.registry import connected
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.truth import TrueLaboratory, build_laboratory


def save_perfect_record(path: Path, *, rig_path: Path) -> Path:
    """Write the record of a rig whose devices are the twin's."""
    rig = load_rig(rig_path)
    assert rig.config.world is not None
    laboratory = build_laboratory(rig.config.laboratory, rig.config.world)
    flat = HeightMap(np.zeros((3, 3), np.float32), 1.0, np.zeros(3))
    devices = rig.open_devices(0, load_heightmap=lambda: flat)
    with connected(devices):
        identities = device_identities(devices)
    results = make_results(
        camera=laboratory.camera,
        trs_from_trk=laboratory.trk_from_trs.inv(),
        tmac_from_cam=laboratory.flange_from_tmac.inv() * laboratory.flange_from_cam,
        p_lamp_trs_m=laboratory.p_light_trs_m,
    )
    record = make_record(
        results,
        rig_name=rig.name,
        devices={name: identities[name] for name in ("camera", "tracker", "tmac")},
    )
    frame = _measured(laboratory, rig.config.laboratory.reflectors)
    replace(record, inputs=record.inputs.with_parts(frame=frame)).save(path)
    return path


def _measured(laboratory: TrueLaboratory, reflectors: ReflectorsSpec) -> FrameInput:
    """Give the reflectors where they truly are, as if measured by a tracker of 20 um."""
    readings = {
        name: PointReading(
            target=name,
            p_trk_m=laboratory.trk_from_trs.apply(laboratory.p_targets_trs_m[name]),
            covariance_m2=2e-5**2 * np.eye(3),
            time_s=0.0,
        )
        for name in reflectors.points_m
    }
    return FrameInput(
        measured_utc="2026-01-02T03:04:05Z", reflectors=reflectors, points=points_of(readings)
    )
