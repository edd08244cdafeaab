"""What stands before the simulated tracker: reflectors, a T-MAC, and air."""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Protocol

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.readings import AirReading, PointReading, PoseReading
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb
from tronlab.twin.instruments import TrackerOptics
from tronlab.twin.world import World

STATION_NAME: Final = "tracker"
SCATTER_M: Final = 2e-6
"""How far measurements of the simulated laboratory scatter, each coordinate of a reading's mean."""
SCATTER_RAD: Final = 1e-5
"""The same of each component of the rotation vector."""


class Scene(Protocol):
    """What the tracker sees."""

    @property
    def serial(self) -> int:
        """Get the serial number of tracker and T-MAC, 0 to 2**31 - 1."""
        ...

    @property
    def reflectors(self) -> Mapping[str, FloatArray]:
        """Get the true centre of every reflector by name, shape (3,), metres, frame trk."""
        ...

    @property
    def trk_from_tmac(self) -> RigidTransform | None:
        """Get where the T-MAC truly is now; None if there is none."""
        ...

    @property
    def air(self) -> AirReading:
        """Get the air that the beam goes through."""
        ...

    def point(self, name: str) -> PointReading:
        """Measure a reflector now, with noise; the covariance is that of the scatter alone."""
        ...

    def pose(self) -> PoseReading:
        """Measure the T-MAC now, with noise; the covariance is that of the scatter alone."""
        ...

    def begin(self, call: str) -> None:
        """Count a call of the driver; a rig file can script faults for it.

        Raises:
            TrackingLostError: The script says so; likewise DeviceTimeoutError, DeviceFaultError.
        """
        ...


class StaticScene:
    """A small scene that never changes by itself; its noise is scatter and nothing else.

    Args:
        noise: Of the measurements.
        coordinate_sigma_m: Of each coordinate.
        rotation_sigma_rad: Of each component of the rotation vector.
    """

    serial = 901_0042

    def __init__(
        self,
        noise: Generator,
        *,
        coordinate_sigma_m: float = 15e-6,
        rotation_sigma_rad: float = 1e-4,
    ) -> None:
        self.reflectors: dict[str, FloatArray] = {
            "top_left": np.array([3.0, 2.0, 1.1]),
            "bottom_left": np.array([3.0, 2.0, -1.06]),
            "top_right": np.array([3.2, -2.15, 1.1]),
            "lamp": np.array([1.0, 3.5, 1.9]),
        }
        self.trk_from_tmac: RigidTransform | None = RigidTransform.from_components(
            [2.5, 0.3, -0.2], Rotation.from_euler("ZYX", [170.0, 20.0, -35.0], degrees=True)
        )
        self.air = AirReading(temperature_k=294.65, pressure_pa=98_700.0, relative_humidity=0.41)
        self._noise = noise
        self._sigma_m = coordinate_sigma_m
        self._sigma_rad = rotation_sigma_rad

    def point(self, name: str) -> PointReading:
        """Measure a reflector now."""
        return PointReading(
            target=name,
            p_trk_m=self.reflectors[name] + self._sigma_m * self._noise.standard_normal(3),
            covariance_m2=self._sigma_m**2 * np.eye(3),
            time_s=time.time(),
        )

    def pose(self) -> PoseReading:
        """Measure the T-MAC now.

        Raises:
            ValueError: There is none.
        """
        if self.trk_from_tmac is None:
            raise ValueError("pose: the scene has no T-MAC")
        sigma = np.repeat([self._sigma_rad, self._sigma_m], 3)
        return PoseReading(
            trk_from_tmac=perturb(self.trk_from_tmac, sigma * self._noise.standard_normal(6)),
            covariance=np.diag(sigma**2),
            time_s=time.time(),
            air=self.air,
        )

    def begin(self, call: str) -> None:
        """Count nothing: nothing is scripted."""


class WorldScene:
    """The simulated laboratory that other simulators show too.

    Its stated accuracy makes most of the noise, and like a real tracker it does not report that.
    """

    def __init__(self, world: World, noise: Generator) -> None:
        self._world = world
        self._optics = TrackerOptics(world, noise)
        self._scatter = noise.spawn(1)[0]

    @property
    def serial(self) -> int:
        """Get the laboratory's serial number."""
        return int(self._world.serial)

    @property
    def reflectors(self) -> Mapping[str, FloatArray]:
        """Get the true centre of every reflector."""
        return self._optics.reflectors

    @property
    def trk_from_tmac(self) -> RigidTransform:
        """Get where the T-MAC truly is now."""
        return self._world.truth.trk_from_tmac

    @property
    def air(self) -> AirReading:
        """Get the air of the room."""
        return self._optics.air()

    def point(self, name: str) -> PointReading:
        """Measure a reflector now."""
        reading = self._optics.point(name)
        scatter_m = SCATTER_M * self._scatter.standard_normal(3)
        return replace(
            reading, p_trk_m=reading.p_trk_m + scatter_m, covariance_m2=SCATTER_M**2 * np.eye(3)
        )

    def pose(self) -> PoseReading:
        """Measure the T-MAC now."""
        reading = self._optics.pose()
        sigma = np.repeat([SCATTER_RAD, SCATTER_M], 3)
        scatter = sigma * self._scatter.standard_normal(6)
        return replace(
            reading,
            trk_from_tmac=perturb(reading.trk_from_tmac, scatter),
            covariance=np.diag(sigma**2),
        )

    def begin(self, call: str) -> None:
        """Count a call in the world's script."""
        self._world.faults.count("tracker", call, name=STATION_NAME)
