"""The quality gate on the twin: false alarms on a good campaign, and what of damage it finds.

    python benchmarks/gate.py [--campaign campaigns/straight_line.yaml] [--damaged 10]

Takes every shot of the campaign without any damage and counts flags. Then the laboratory is
damaged from the middle of the campaign on, for so many shots: a blurred lens, a lamp 30 % dimmer,
a tracker that scatters five times as much, a lamp five times as bright. The gate
should hold the damage, and nothing else, against each of these shots. Also prints what judging
one shot costs.
"""

import argparse
import statistics
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.brightness import LightModel
from tronlab.campaign.config import load_campaign
from tronlab.campaign.gate import Evidence, measure_quality
from tronlab.campaign.rig import Rig, load_rig
from tronlab.campaign.settling import Motion
from tronlab.campaign.shot import ShotTaker, TruthSource
from tronlab.dataset.records import ErrorClass, ShotRecord
from tronlab.devices.registry import connected
from tronlab.errors import NotSettledError
from tronlab.planning.shots import Shot, make_plan
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.renderer import Lamp
from tronlab.trajectory.poses import camera_poses
from tronlab.twin.config import WorldConfig
from tronlab.yaml_models import read_text

ROOT = Path(__file__).parents[1]
NO_RETAKES: dict[ErrorClass, int] = {"quality": 99}
"""Every retake is used up: flags are stored, and no shot is taken twice."""


def psf(sigma_px: float) -> Callable[[WorldConfig], WorldConfig]:
    def damage(world: WorldConfig) -> WorldConfig:
        lens = world.lens.model_copy(update={"psf_sigma_px": sigma_px})
        return world.model_copy(update={"lens": lens})

    return damage


def lamp(factor: float) -> Callable[[WorldConfig], WorldConfig]:
    def damage(world: WorldConfig) -> WorldConfig:
        intensity = world.lamp.intensity_w_per_sr * factor
        update = {"intensity_w_per_sr": intensity}
        return world.model_copy(update={"lamp": world.lamp.model_copy(update=update)})

    return damage


def scatter(factor: float) -> Callable[[WorldConfig], WorldConfig]:
    def damage(world: WorldConfig) -> WorldConfig:
        tracker = world.tracker
        names = ("coordinate_sigma_m", "coordinate_sigma_m_per_m", "rotation_sigma_deg")
        update = {name: factor * getattr(tracker, name) for name in names}
        return world.model_copy(update={"tracker": tracker.model_copy(update=update)})

    return damage


DAMAGE: dict[str, Callable[[WorldConfig], WorldConfig]] = {
    "blur, sigma 1 px": psf(1.0),
    "blur, sigma 2 px": psf(2.0),
    "lamp 10 % dimmer": lamp(0.9),
    "lamp 30 % dimmer": lamp(0.7),
    "lamp 5 x as bright": lamp(5.0),
    "tracker scatters 5 x": scatter(5.0),
}


class Trial:
    """A campaign on the twin, shot by shot and without a dataset."""

    def __init__(self, campaign_path: Path) -> None:
        campaign = load_campaign(campaign_path)
        self.config = campaign.config
        self.rig = load_rig(self.config.rig)
        text = read_text(self.config.calibration)
        self.calibration = CalibrationRecord.from_json(text, source="calibration")
        self.heightmap = self.rig.load_heightmap()
        self.renderer = HeightfieldRenderer(self.heightmap)
        mounting = self.calibration.mounting(self.rig.config.laboratory.mounting)
        self.shots = make_plan(camera_poses(self.config.trajectory), mounting=mounting).shots
        self.light = LightModel(
            self.renderer,
            self.heightmap,
            self.calibration.camera,
            Lamp(p_trs_m=self.calibration.p_lamp_trs_m, intensity=1.0),
            self.config.database.photometry,
        )

    def take(
        self,
        shots: Sequence[Shot],
        damage: Callable[[WorldConfig], WorldConfig] | None = None,
        before: Sequence[ShotRecord] = (),
    ) -> list[ShotRecord]:
        """Take shots in a laboratory that may be damaged, after good ones."""
        rig = self.rig if damage is None else _damaged(self.rig, damage)
        devices = rig.open_devices(self.config.seed, load_heightmap=lambda: self.heightmap)
        registration = self.rig.config.terrain.registration
        truth_source = TruthSource(self.calibration, self.heightmap, self.renderer, registration)
        taker = ShotTaker(devices, self.config, truth_source, light=self.light)
        for record in before:
            if record.quality is not None:
                taker.gate.learn(record.quality, range_los_m=record.truth.range_los_m)
        camera = self.config.camera
        with connected(devices):
            devices.camera.configure(
                exposure_s=camera.exposure_s,
                gain_db=camera.gain_db,
                pixel_format=camera.pixel_format,
            )
            devices.room.switch_lamp(on=True)
            return [record for shot in shots if (record := _take(taker, shot)) is not None]

    def costs_ms(self, records: Sequence[ShotRecord]) -> tuple[float, float]:
        """Give the medians of measuring a shot and of predicting its brightness, processor time."""
        measuring: list[float] = []
        predicting: list[float] = []
        for record in records:
            evidence = _evidence(record)
            begin_s = time.process_time()
            measure_quality(evidence)
            middle_s = time.process_time()
            self.light.mean_radiance(record.truth.trs_from_cam)
            measuring.append(middle_s - begin_s)
            predicting.append(time.process_time() - middle_s)
        return 1e3 * statistics.median(measuring), 1e3 * statistics.median(predicting)


def _damaged(rig: Rig, damage: Callable[[WorldConfig], WorldConfig]) -> Rig:
    world = rig.config.world
    if world is None:
        raise SystemExit("the campaign's rig is no simulated one")
    return replace(rig, config=rig.config.model_copy(update={"world": damage(world)}))


def _take(taker: ShotTaker, shot: Shot) -> ShotRecord | None:
    """Take a shot; None if the camera did not come to rest, as far as the tracker can tell."""
    taker.begin(shot, 1, n_failures=NO_RETAKES)
    taker.move()
    try:
        taker.settle()
        taker.measure()
        taker.grab()
        taker.confirm()
    except NotSettledError:
        return None
    taker.read()
    taker.judge()
    return taker.assemble()


def _evidence(record: ShotRecord) -> Evidence:
    if record.tracker is None or record.room is None:
        raise ValueError(f"shot {record.shot_id} was not taken by a laboratory")
    return Evidence(
        frame=record.frame,
        mask=record.mask,
        truth=record.truth,
        trs_from_cam_nominal=record.trs_from_cam_nominal,
        tracker=record.tracker,
        room=record.room,
        settled=Motion(0.0, 0.0),
        confirmed=Motion(0.0, 0.0),
        predicted_radiance=1.0,
    )


def _flags(records: Sequence[ShotRecord]) -> str:
    counts = Counter(flag for record in records for flag in record.quality.flags)
    return ", ".join(f"{flag} {n}" for flag, n in counts.items()) or "none"


def _spread(values: Sequence[float]) -> str:
    median = statistics.median(values)
    return f"{min(values) / median:.3f} to {max(values) / median:.3f} of the median {median:.4g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaign", type=Path, default=ROOT / "campaigns" / "straight_line.yaml")
    parser.add_argument("--damaged", type=int, default=10, help="shots of each damage")
    arguments = parser.parse_args()

    trial = Trial(arguments.campaign)
    good = trial.take(trial.shots)
    print(f"{len(good)} good shots, flags: {_flags(good)}")
    print(f"  sharpness  {_spread([record.quality.sharpness for record in good])}")
    print(f"  brightness {_spread([record.quality.brightness for record in good])}")
    measuring_ms, predicting_ms = trial.costs_ms(good)
    shape = good[0].frame.image.shape
    print(f"cost of one shot {shape}: {measuring_ms:.1f} ms, prediction {predicting_ms:.1f} ms")
    middle = len(good) // 2
    for name, damage in DAMAGE.items():
        shots = trial.shots[middle : middle + arguments.damaged]
        records = trial.take(shots, damage, before=good[:middle])
        not_settled = f", never at rest: {len(shots) - len(records)}"
        print(f"{name:20s} {len(shots)} shots, flags: {_flags(records)}{not_settled}")


if __name__ == "__main__":
    main()
