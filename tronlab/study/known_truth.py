"""Calibration records of a simulated laboratory in which parts are what is true, not measured."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tronlab.errors import ConfigError
from tronlab.study.config import MeasuredPart

if TYPE_CHECKING:
    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.results import Results
    from tronlab.campaign.rig import Rig
    from tronlab.twin.truth import TrueLaboratory


def with_truth(
    record: "CalibrationRecord", rig: "Rig", known: Collection[MeasuredPart]
) -> "CalibrationRecord":
    """Give a record as it would be if some parts were known without error.

    It is the record of the rig as given, whose devices may differ from those it was measured with,
    as a camera without noise does.

    Args:
        record: As measured.
        rig: A simulated laboratory built alike.
        known: Parts that become what is true, with a covariance of zero.

    Raises:
        ConfigError: The rig is of hardware: nobody knows what is true.
    """
    from tronlab.twin.truth import build_laboratory, serial_number

    world, spec = rig.config.world, rig.config.laboratory
    if world is None:
        raise ConfigError(
            "the rig has no world: only of a simulated laboratory it is known what is true",
            path=rig.path,
        )
    truth, results = build_laboratory(spec, world), record.results
    for part in sorted(known):
        results = _WITH_TRUE[part](results, truth)
    serial = serial_number(spec, world)
    devices = {name: replace(device, serial=serial) for name, device in record.devices.items()}
    return replace(record, results=results, devices=devices)


def _with_true_frame(results: "Results", truth: "TrueLaboratory") -> "Results":
    if results.frame is None:
        return results
    true = truth.trk_from_trs.inv()
    return replace(
        results, frame=replace(results.frame, trs_from_trk=true, covariance=np.zeros((6, 6)))
    )


def _with_true_intrinsics(results: "Results", truth: "TrueLaboratory") -> "Results":
    if results.camera is None:
        return results
    nothing = np.zeros_like(results.camera.covariance)
    return replace(results, camera=replace(results.camera, camera=truth.camera, covariance=nothing))


def _with_true_hand_eye(results: "Results", truth: "TrueLaboratory") -> "Results":
    if results.hand_eye is None:
        return results
    true = truth.flange_from_tmac.inv() * truth.flange_from_cam
    return replace(
        results, hand_eye=replace(results.hand_eye, tmac_from_cam=true, covariance=np.zeros((6, 6)))
    )


def _with_true_lamp(results: "Results", truth: "TrueLaboratory") -> "Results":
    if results.lamp is None:
        return results
    true = truth.p_light_trs_m
    return replace(
        results, lamp=replace(results.lamp, p_trs_m=true, covariance_m2=np.zeros((3, 3)))
    )


def _with_true_photometry(results: "Results", truth: "TrueLaboratory") -> "Results":
    if results.photometry is None:
        return results
    true = replace(results.photometry, photometry=truth.photometry, weight_sigma=0.0)
    return replace(results, photometry=true)


_WITH_TRUE: "Mapping[MeasuredPart, Callable[[Results, TrueLaboratory], Results]]" = {
    "frame": _with_true_frame,
    "intrinsics": _with_true_intrinsics,
    "hand_eye": _with_true_hand_eye,
    "lamp": _with_true_lamp,
    "photometry": _with_true_photometry,
}
