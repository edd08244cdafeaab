"""How well the simulated laboratory's devices do, at this instant.

Where a robot comes to stand, what a tracker and a camera see. The devices add calls, waiting and
time; simulators on the wire add protocols.
"""

import numpy as np
from numpy.random import Generator

from tronlab.devices.laboratory import CameraSpec
from tronlab.devices.readings import AirReading, PointReading, PoseReading, RobotTarget
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb
from tronlab.twin.sensor import GreyImage, blur, digitise, expose
from tronlab.twin.truth import named_rng
from tronlab.twin.world import World


def noise_of(kind: str, *, seed: int, session: str) -> Generator:
    """Give the noise of a kind of device: another one for every session of a seed."""
    return named_rng(seed, f"noise of {kind} in {session}")


class Positioning:
    """Where rail and arm really come to stand: encoders say what was commanded."""

    def __init__(self, world: World, rng: Generator) -> None:
        self._world = world
        self._rng = rng
        self._rail_error_m = 0.0

    def actual(self, target: RobotTarget) -> RobotTarget:
        """Give where the robot really stands after a move from where it stands to a target."""
        config = self._world.config.robot
        rail, *arm = self._rng.standard_normal(7)
        step_m = target.rail_m - self._world.robot_at.rail_m
        if step_m != 0.0:  # a rail that does not move keeps its error
            backlash_m = config.rail_backlash_m if step_m < 0.0 else 0.0
            self._rail_error_m = config.rail_repeatability_sigma_m * rail + backlash_m
        sigma = np.repeat([config.repeatability_sigma_rad, config.repeatability_sigma_m], 3)
        return RobotTarget(
            rail_m=target.rail_m + self._rail_error_m,
            base_from_flange=perturb(target.base_from_flange, sigma * np.array(arm)),
        )


class TrackerOptics:
    """What the laser tracker sees, with noise."""

    def __init__(self, world: World, rng: Generator) -> None:
        self._world = world
        self._rng = rng

    @property
    def reflectors(self) -> dict[str, FloatArray]:
        """Get the true centre of every reflector by name, shape (3,), frame trk."""
        truth = self._world.truth
        return {
            name: truth.trk_from_trs.apply(p_trs)
            for name, p_trs in truth.laboratory.p_targets_trs_m.items()
        }

    def point(self, name: str) -> PointReading:
        """Measure a reflector now."""
        p_trk = self.reflectors[name]
        covariance = self._world.config.tracker.point_covariance(p_trk)
        return PointReading(
            target=name,
            p_trk_m=p_trk + np.sqrt(np.diag(covariance)) * self._rng.standard_normal(3),
            covariance_m2=covariance,
            time_s=self._world.clock.now_s,
        )

    def pose(self) -> PoseReading:
        """Measure the T-MAC now."""
        trk_from_tmac = self._world.truth.trk_from_tmac
        covariance = self._world.config.tracker.pose_covariance(trk_from_tmac.translation)
        error = np.sqrt(np.diag(covariance)) * self._rng.standard_normal(6)
        return PoseReading(
            trk_from_tmac=perturb(trk_from_tmac, error),
            covariance=covariance,
            time_s=self._world.clock.now_s,
            air=self.air(),
        )

    def air(self) -> AirReading:
        """Read the weather station."""
        state = self._world.state.read()
        return AirReading(
            temperature_k=state.air_temperature_k,
            pressure_pa=state.air_pressure_pa,
            relative_humidity=state.relative_humidity,
        )


class CameraOptics:
    """What lens and sensor make of the light that reaches the camera."""

    def __init__(self, world: World, rng: Generator) -> None:
        self._world = world
        self._rng = rng

    def image(
        self,
        *,
        exposure_s: float,
        gain_db: float,
        pixel_format: str,
        region: CameraSpec | None = None,
    ) -> GreyImage:
        """Expose now, whatever moves.

        Args:
            exposure_s: Time of exposure.
            gain_db: Gain.
            pixel_format: ``Mono8`` or ``Mono12``.
            region: The camera with the region of the sensor to read out; by default the rig's.

        Returns:
            Grey values, shape (rows, columns) of the region.
        """
        config = self._world.config
        seen = blur(self._world.radiance(region), sigma_px=config.lens.psf_sigma_px)
        electrons = expose(seen, config.sensor, exposure_s=exposure_s, rng=self._rng)
        return digitise(electrons, config.sensor, gain_db=gain_db, pixel_format=pixel_format)
