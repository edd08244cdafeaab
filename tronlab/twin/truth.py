"""The laboratory as built: drawn once from the world's seed, then fixed."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, SeedSequence
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.laboratory import CameraSpec, LaboratorySpec, LampSpec, ReflectorsSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, unit
from tronlab.geometry.uncertainty import perturb
from tronlab.render.photometry import Photometry
from tronlab.twin.config import (
    Deviation,
    LensConfig,
    RobotConfig,
    TrackerConfig,
    TrueLampConfig,
    WorldConfig,
)

LAMP_TARGET = "lamp"
"""Name of the reflector on the lamp's housing."""


@dataclass(frozen=True, slots=True)
class TrueLaboratory:
    """What does not change while the laboratory is used."""

    trk_from_trs: RigidTransform
    """Before anyone moved the tracker."""
    trs_from_rail: RigidTransform
    rail_axis: FloatArray
    """How far the base moves for one metre of the rail's encoder, shape (3,), frame rail."""
    flange_from_cam: RigidTransform
    flange_from_tmac: RigidTransform
    sensor: CameraModel
    """Camera with the whole sensor."""
    camera: CameraModel
    """Camera with the region that the rig reads out."""
    p_targets_trs_m: Mapping[str, FloatArray]
    """Centre of every reflector by name, shape (3,), frame trs."""
    p_light_trs_m: FloatArray
    """Centre of the light, shape (3,)."""
    board_bow_m: FloatArray
    """Sag along x, sag along y and twist of the calibration board, shape (3,); see ``board``."""
    photometry: Photometry
    """How the terrain model reflects light."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of the world at one moment; for tests only."""

    laboratory: TrueLaboratory
    trs_from_flange: RigidTransform
    trs_from_board: RigidTransform | None
    """None while no board is placed."""
    is_lamp_on: bool
    trk_from_trs: RigidTransform
    """Where the tracker stands now."""

    @property
    def trs_from_cam(self) -> RigidTransform:
        """Get the camera's pose."""
        return self.trs_from_flange * self.laboratory.flange_from_cam

    @property
    def trs_from_tmac(self) -> RigidTransform:
        """Get the T-MAC's pose."""
        return self.trs_from_flange * self.laboratory.flange_from_tmac

    @property
    def trk_from_tmac(self) -> RigidTransform:
        """Get the T-MAC's pose as an exact tracker would measure it."""
        return self.trk_from_trs * self.trs_from_tmac


def named_rng(seed: int, name: str) -> Generator:
    """Give the random numbers of one purpose: independent of those of every other name."""
    return np.random.default_rng(SeedSequence(seed, spawn_key=tuple(name.encode())))


def deviate(pose: RigidTransform, deviation: Deviation, rng: Generator) -> RigidTransform:
    """Move a pose by a random deviation in its parent frame."""
    dw = np.radians(deviation.sigma_deg) * rng.standard_normal(3)
    return perturb(pose, np.concatenate([dw, deviation.sigma_m * rng.standard_normal(3)]))


def build_laboratory(spec: LaboratorySpec, config: WorldConfig) -> TrueLaboratory:
    """Draw the laboratory from ``config.seed``; every quantity has random numbers of its own."""
    mounting, seed = spec.mounting, config.seed
    p_light = np.array(spec.lamp.p_trs_m) + config.lamp.placement_sigma_m * named_rng(
        seed, "light"
    ).standard_normal(3)
    p_targets = _true_reflectors(spec.reflectors, config.tracker, seed)
    sensor = _true_sensor(spec.camera, config.lens, named_rng(seed, "lens"))
    p_targets[LAMP_TARGET] = _housing_target(
        p_light, spec.lamp, config.lamp, named_rng(seed, "housing")
    )
    return TrueLaboratory(
        trk_from_trs=_place_tracker(spec, config, named_rng(seed, "tracker")).inv(),
        trs_from_rail=deviate(
            mounting.trs_from_rail.pose, config.robot.rail_deviation, named_rng(seed, "rail")
        ),
        rail_axis=_true_rail_axis(config.robot, named_rng(seed, "rail axis")),
        flange_from_cam=deviate(
            mounting.flange_from_cam.pose,
            config.mounting.camera_deviation,
            named_rng(seed, "camera mounting"),
        ),
        flange_from_tmac=deviate(
            mounting.flange_from_tmac.pose,
            config.mounting.tmac_deviation,
            named_rng(seed, "tmac mounting"),
        ),
        sensor=sensor,
        camera=read_out(sensor, spec.camera),
        p_targets_trs_m=p_targets,
        p_light_trs_m=p_light,
        board_bow_m=config.board.bow_sigma_m * named_rng(seed, "board bow").standard_normal(3),
        photometry=config.surface.photometry,
    )


def serial_number(spec: LaboratorySpec, config: WorldConfig) -> str:
    """Give a serial number that two laboratories share only if they are built alike.

    Scripted faults leave it as it is: they happen to a laboratory and do not make another one. So
    do the terrain, its surface, the size of the lamp and who renders it: nothing that is calibrated
    depends on them. It is a number below 2^31, as trackers have.
    """
    parts = {
        "laboratory": spec.model_dump(mode="json"),
        "world": config.model_dump(
            mode="json",
            exclude={"faults": True, "terrain": True, "surface": True, "lamp": {"radius_m"}},
        ),
    }
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).digest()
    return str(int.from_bytes(digest[:4]) >> 1)


def _true_reflectors(
    spec: ReflectorsSpec, config: TrackerConfig, seed: int
) -> dict[str, FloatArray]:
    """Place the centres of the reflectors.

    F_TRS is defined by three of them, so three of their coordinates are free and no more.
    """
    down, right_x, right_y = _survey_errors(spec, config, named_rng(seed, "reflectors"))
    deviations = {
        "bottom_left": np.array([down, 0.0, 0.0]),
        "top_right": np.array([right_x, right_y, 0.0]),
    }
    for name in spec.more_m:
        errors = named_rng(seed, f"reflector {name}").standard_normal(3)
        deviations[name] = config.survey_sigma_m * errors
    return {
        name: np.array(p_mark)
        + deviations.get(name, np.zeros(3))
        + np.array([0.0, 0.0, spec.centre_heights_m[name]])
        for name, p_mark in spec.points_m.items()
    }


def _survey_errors(spec: ReflectorsSpec, config: TrackerConfig, rng: Generator) -> FloatArray:
    """Give by how much the free coordinates of the three reflectors differ from nominal."""
    if spec.more_m:
        return config.survey_sigma_m * rng.standard_normal(3)
    return config.reflector_deviation_m * rng.uniform(-1.0, 1.0, 3)


def _true_rail_axis(config: RobotConfig, rng: Generator) -> FloatArray:
    about_y, about_z, scale = rng.standard_normal(3)
    turn = np.radians(config.rail_axis_sigma_deg) * np.array([0.0, about_y, about_z])
    axis = Rotation.from_rotvec(turn).apply([1.0, 0.0, 0.0])
    return (1.0 + config.rail_scale_sigma * scale) * axis


def _housing_target(
    p_light: FloatArray, spec: LampSpec, config: TrueLampConfig, rng: Generator
) -> FloatArray:
    """Place the reflector off where the rig file says by a distance nobody has measured."""
    unknown = config.housing_offset_m * unit(rng.standard_normal(3))
    return p_light - np.array(spec.light_from_reflector_m) + unknown


def _place_tracker(spec: LaboratorySpec, config: WorldConfig, rng: Generator) -> RigidTransform:
    """Give ``trs_from_trk``: in front of the model, to one side of the rail, roughly level."""
    reflectors = spec.reflectors
    centre = (np.array(reflectors.bottom_left_m) + np.array(reflectors.top_right_m)) / 2
    azimuth = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(30.0, 60.0))
    direction = np.array([0.0, np.sin(azimuth), np.cos(azimuth)])
    p_trs = centre + rng.uniform(*config.tracker.distance_range_m) * direction
    upright = Rotation.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    heading = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    tilt = Rotation.from_rotvec(np.radians(1.0) * rng.standard_normal(3))
    return RigidTransform.from_components(p_trs, upright * heading * tilt)


def read_out(sensor: CameraModel, region: CameraSpec) -> CameraModel:
    """Give the camera whose image is a region of the sensor."""
    return sensor.cropped(
        left_px=region.left_px,
        top_px=region.top_px,
        width_px=region.width_px,
        height_px=region.height_px,
    )


def _true_sensor(spec: CameraSpec, lens: LensConfig, rng: Generator) -> CameraModel:
    """Put the lens in front of the whole sensor."""
    focal, aspect, *centre = rng.standard_normal(4)
    fx = lens.focal_length_m / spec.pixel_pitch_m * (1.0 + lens.focal_length_sigma * focal)
    draws = rng.standard_normal(5)
    k1, k2, p1, p2, k3 = (
        float(mean + sigma * draw)
        for mean, sigma, draw in zip(lens.distortion, lens.distortion_sigma, draws, strict=True)
    )
    return CameraModel(
        width_px=spec.sensor_width_px,
        height_px=spec.sensor_height_px,
        fx_px=float(fx),
        fy_px=float(fx * (1.0 + lens.aspect_sigma * aspect)),
        cx_px=float((spec.sensor_width_px - 1) / 2 + lens.principal_point_sigma_px * centre[0]),
        cy_px=float((spec.sensor_height_px - 1) / 2 + lens.principal_point_sigma_px * centre[1]),
        distortion=(k1, k2, p1, p2, k3),
    )
