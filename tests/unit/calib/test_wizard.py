"""The wizard on the twin, with a quarter of the pixels and no terrain."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from tronlab.calib.measurements import Measurements
from tronlab.calib.projection import intrinsics_of
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.solve import solve_calibration
from tronlab.calib.wizard import CalibrationSettings, calibrate, measure
from tronlab.campaign.rig import Rig, load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.registry import KINDS, DeviceContext, Devices, make_device
from tronlab.errors import CalibrationError, DeviceTimeoutError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.uncertainty import pose_difference
from tronlab.render.renderer import Rendering
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.config import WorldConfig
from tronlab.twin.devices import WORLD_KEY
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"
pytestmark = pytest.mark.opencv


class DarkTerrain:
    def render(self, camera: CameraModel, *_: Any, **__: Any) -> Rendering:
        return Rendering(
            radiance=np.full(camera.shape, 0.02, np.float32),
            depth_m=np.ones(camera.shape, np.float32),
            points_trs_m=np.zeros((*camera.shape, 3), np.float32),
            is_lit=np.ones(camera.shape, np.bool_),
        )


@dataclass
class Notes:
    lines: list[str] = field(default_factory=list)
    steps: list[tuple[int, int]] = field(default_factory=list)

    def announce(self, text: str) -> None:
        self.lines.append(text)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        self.steps.append((n_done, n_all))


@dataclass
class Bench:
    devices: Devices
    world: World
    laboratory: LaboratorySpec
    notes: Notes = field(default_factory=Notes)

    def measure(self) -> Measurements:
        return measure(
            self.devices, self.laboratory, settings=CalibrationSettings(), progress=self.notes
        )

    def calibrate(self) -> CalibrationRecord:
        return calibrate(
            self.devices,
            self.laboratory,
            rig_name="small",
            software={"tronlab": "0"},
            settings=CalibrationSettings(),
            progress=self.notes,
        )


def halved(laboratory: LaboratorySpec) -> LaboratorySpec:
    camera = laboratory.camera
    names = ("sensor_width_px", "sensor_height_px", "left_px", "width_px", "height_px")
    sizes = {name: getattr(camera, name) // 2 for name in names}
    camera = camera.model_copy(update={**sizes, "pixel_pitch_m": camera.pixel_pitch_m * 2})
    return laboratory.model_copy(update={"camera": camera})


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(TWIN_YAML)


@pytest.fixture(scope="module")
def make_bench(rig: Rig) -> Callable[..., Bench]:
    def make(**sections: Any) -> Bench:
        assert rig.config.world is not None
        world_config = {**rig.config.world.model_dump(), **sections}
        setup = WorldSetup(
            config=WorldConfig.model_validate(world_config),
            laboratory=halved(rig.config.laboratory),
            load_heightmap=lambda: HeightMap(
                np.zeros((3, 5), np.float32), spacing_m=1.0, origin_trs_m=np.zeros(3)
            ),
        )
        world = World(setup, make_renderer=lambda _: DarkTerrain())
        devices = {}
        for kind in KINDS:
            context = DeviceContext(kind, options={}, seed=3, world=setup)
            context.shared[WORLD_KEY] = world
            devices[kind] = make_device(f"twin.{kind}", kind, context)
            devices[kind].connect()
        return Bench(Devices(**devices), world, setup.laboratory)

    return make


@pytest.fixture(scope="module")
def done(make_bench: Callable[..., Bench]) -> tuple[Bench, CalibrationRecord]:
    bench = make_bench()
    return bench, bench.calibrate()


@pytest.fixture(scope="module")
def measured(make_bench: Callable[..., Bench]) -> Measurements:
    """Measured with the beam lost at the second station."""
    fault = {"device": "tracker", "call": "measure_pose", "at": 2, "error": "tracking_lost"}
    return make_bench(faults=[fault]).measure()


def nees(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def test_every_result_lies_within_its_covariance(done: tuple[Bench, CalibrationRecord]) -> None:
    bench, record = done
    truth = bench.world.laboratory
    frame_error = pose_difference(record.trs_from_trk, truth.trk_from_trs.inv())
    assert nees(frame_error, record.trs_from_trk_covariance) < chi2.ppf(0.999, 6)
    tmac_from_cam = truth.flange_from_tmac.inv() * truth.flange_from_cam
    hand_eye_error = pose_difference(record.tmac_from_cam, tmac_from_cam)
    assert nees(hand_eye_error, record.tmac_from_cam_covariance) < chi2.ppf(0.999, 6)
    intrinsics_error = intrinsics_of(record.camera) - intrinsics_of(truth.camera)
    assert nees(intrinsics_error, record.camera_covariance) < chi2.ppf(0.999, 9)
    lamp_error = record.p_lamp_trs_m - truth.p_targets_trs_m["lamp"]
    assert nees(lamp_error, record.p_lamp_trs_covariance_m2) < chi2.ppf(0.999, 3)


def test_the_truth_of_a_shot_lies_within_its_covariance(
    done: tuple[Bench, CalibrationRecord],
) -> None:
    bench, record = done
    reading = bench.devices.tracker.measure_pose(window_s=1.0)
    trs_from_cam, covariance = record.trs_from_cam(reading)
    error = pose_difference(trs_from_cam, bench.world.truth.trs_from_cam)
    assert nees(error, covariance) < chi2.ppf(0.999, 6)
    assert np.sqrt(np.trace(covariance[3:, 3:])) < 0.25e-3
    assert np.degrees(np.sqrt(np.trace(covariance[:3, :3]))) < 0.015


def test_the_record_says_how_it_came_about(done: tuple[Bench, CalibrationRecord]) -> None:
    bench, record = done
    assert record.rig_name == "small"
    assert record.devices["tmac"] == bench.devices.tracker.identify_target()
    assert len(record.inputs["stations"]) == record.statistics["n_stations"] >= 20
    assert set(record.inputs["reflectors"]) == {"top_left", "bottom_left", "top_right"}
    assert record.statistics["p_value_poses"] > 1e-3
    assert bench.notes.steps[-1] == (27, 27)
    again = CalibrationRecord.from_json(record.to_json())
    assert again.statistics == record.statistics


def test_the_board_is_taken_away_afterwards(done: tuple[Bench, CalibrationRecord]) -> None:
    assert done[0].world.truth.trs_from_board is None


def test_a_board_that_moved_is_noticed(measured: Measurements) -> None:
    shifted = [
        type(s)(
            s.reading, type(s.view)(s.view.ids, s.view.p_board_m, s.view.uv_px + 2.0 * (i > 12))
        )
        for i, s in enumerate(measured.stations)
    ]
    moved = replace(measured, stations=tuple(shifted))
    with pytest.raises(CalibrationError, match="tracker and camera contradict each other"):
        solve_calibration(moved, rig_name="r", devices={}, software={})


def test_swapped_reflectors_show_before_anything_moves(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    targets = dict(bench.world.laboratory.p_targets_trs_m)
    targets["top_left"], targets["top_right"] = targets["top_right"], targets["top_left"]
    object.__setattr__(bench.world.laboratory, "p_targets_trs_m", targets)
    parked = bench.world.state.read().robot_encoders
    with pytest.raises(CalibrationError, match="top_left, top_right are swapped"):
        bench.calibrate()
    assert bench.world.state.read().robot_encoders == parked


def test_a_lost_beam_costs_one_station(measured: Measurements) -> None:
    assert len(measured.stations) >= 20
    assert [line.split(":")[0] for line in measured.skipped] == ["pose 1"]


def test_the_board_is_taken_away_when_a_device_fails(make_bench: Callable[..., Bench]) -> None:
    fault = {"device": "camera", "call": "grab", "at": 3, "error": "timeout"}
    bench = make_bench(faults=[fault])
    with pytest.raises(DeviceTimeoutError):
        bench.calibrate()
    assert bench.world.truth.trs_from_board is None


def test_without_light_no_exposure_is_found(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    bench.devices.room.switch_lamp = lambda *, on: None  # type: ignore[method-assign]
    bench.world.state.change(lamp_level=0.0)
    with pytest.raises(CalibrationError, match=r"no exposure found(.|\n)*is the lamp on"):
        bench.calibrate()


def test_poses_out_of_reach_are_listed(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    mounting = bench.laboratory.mounting.model_copy(update={"rail_range_m": (0.0, 3.6)})
    short = bench.laboratory.model_copy(update={"mounting": mounting})
    bench.world.spec = short
    measurements = bench.measure()
    out_of_reach = [line for line in measurements.skipped if "rail position" in line]
    assert out_of_reach
    assert len(measurements.stations) + len(measurements.skipped) == 27


def test_an_image_of_another_size_is_refused(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    camera = bench.laboratory.camera.model_copy(update={"height_px": 400})
    bench.laboratory = bench.laboratory.model_copy(update={"camera": camera})
    with pytest.raises(CalibrationError, match=r"shape \(512, 512\).*says \(400, 512\)"):
        bench.calibrate()
