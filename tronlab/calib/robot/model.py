"""How robot and rail stand, as unknowns: what they predict, and how predictions change with them.

    trk_from_tmac = trk_from_rail * T(rail_m * rail_axis) * base_from_flange * flange_from_tmac

The 15 unknowns change by (rotation vector, translation) of trk_from_rail in trk, then rail_axis,
then (rotation vector, translation) of flange_from_tmac in flange.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.inputs import RobotStationInput
from tronlab.geometry.poses import FloatArray, skew
from tronlab.geometry.uncertainty import perturb

N_UNKNOWNS = 15


@dataclass(frozen=True, slots=True)
class RobotStations:
    """What encoders and tracker said at n stations."""

    rail_m: FloatArray
    """Shape (n,)."""
    base_from_flange: RigidTransform
    """n poses."""
    trk_from_tmac: RigidTransform
    """n poses."""
    covariances: FloatArray
    """Of (rotation vector, translation) in trk, shape (n, 6, 6)."""

    @classmethod
    def of(cls, stations: Sequence[RobotStationInput]) -> "RobotStations":
        """Stack stations."""
        readings = [station.reading.reading for station in stations]
        return cls(
            rail_m=np.array([station.rail_m for station in stations]),
            base_from_flange=_stacked([station.base_from_flange for station in stations]),
            trk_from_tmac=_stacked([reading.trk_from_tmac for reading in readings]),
            covariances=np.array([reading.covariance for reading in readings]),
        )

    def where(self, mask: NDArray[np.bool_]) -> "RobotStations":
        """Give some of the stations; ``mask`` has shape (n,)."""
        return RobotStations(
            rail_m=self.rail_m[mask],
            base_from_flange=self.base_from_flange[mask],
            trk_from_tmac=self.trk_from_tmac[mask],
            covariances=self.covariances[mask],
        )


@dataclass(frozen=True, slots=True)
class RobotModel:
    """How robot and rail stand."""

    trk_from_rail: RigidTransform
    rail_axis: FloatArray
    flange_from_tmac: RigidTransform

    def moved(self, step: FloatArray) -> "RobotModel":
        """Change the unknowns by a step, shape (15,)."""
        return replace(
            self,
            trk_from_rail=perturb(self.trk_from_rail, step[:6]),
            rail_axis=self.rail_axis + step[6:9],
            flange_from_tmac=perturb(self.flange_from_tmac, step[9:]),
        )

    def trk_from_flange(self, stations: RobotStations) -> RigidTransform:
        """Predict the flange at each station."""
        rail_from_base = RigidTransform.from_translation(np.outer(stations.rail_m, self.rail_axis))
        return self.trk_from_rail * rail_from_base * stations.base_from_flange

    def residuals(self, stations: RobotStations) -> FloatArray:
        """Give measured minus predicted (rotation vector, translation) in trk, shape (n, 6)."""
        predicted = self.trk_from_flange(stations) * self.flange_from_tmac
        measured = stations.trk_from_tmac
        turns = (measured.rotation * predicted.rotation.inv()).as_rotvec()
        return np.hstack([turns, measured.translation - predicted.translation])

    def jacobian(self, stations: RobotStations) -> FloatArray:
        """Give the derivatives of the predictions by the unknowns, shape (n, 6, 15)."""
        trk_from_flange = self.trk_from_flange(stations)
        n = len(stations.rail_m)
        rail = self.trk_from_rail.rotation.as_matrix()
        flanges = trk_from_flange.rotation.as_matrix()
        tmacs = (trk_from_flange * self.flange_from_tmac).translation
        jacobian = np.zeros((n, 6, N_UNKNOWNS))
        jacobian[:, :3, :3] = jacobian[:, 3:, 3:6] = np.eye(3)
        jacobian[:, 3:, :3] = -skew(tmacs - self.trk_from_rail.translation)
        jacobian[:, 3:, 6:9] = stations.rail_m[:, None, None] * rail
        jacobian[:, :3, 9:12] = jacobian[:, 3:, 12:] = flanges
        return jacobian

    def levers(self, stations: RobotStations) -> FloatArray:
        """Give the derivatives of the T-MAC's pose by that of the flange, shape (n, 6, 6).

        Both as (rotation vector, translation) in trk: an arm that is off by an angle moves the
        T-MAC over its lever.
        """
        levers = np.tile(np.eye(6), (len(stations.rail_m), 1, 1))
        arms = self.trk_from_flange(stations).rotation.apply(self.flange_from_tmac.translation)
        levers[:, 3:, :3] = -skew(arms)
        return levers


def first_model(stations: RobotStations) -> RobotModel:
    """Solve in closed form: first the rotations, then all translations, which are linear.

    Source of the rotations: Shah, J. Mechanisms Robotics 5 (2013) 031007.
    """
    arms = stations.base_from_flange.rotation.as_matrix()
    tmacs = stations.trk_from_tmac.rotation.as_matrix()
    products = np.einsum("nij,nkl->ikjl", tmacs, arms).reshape(9, 9)
    u, _, vt = np.linalg.svd(products)
    trk_from_rail = _nearest_rotation(u[:, 0].reshape(3, 3))
    flange_from_tmac = _nearest_rotation(vt[0].reshape(3, 3)).T
    n = len(arms)
    design = np.concatenate(
        [
            np.tile(np.eye(3), (n, 1, 1)),
            stations.rail_m[:, None, None] * trk_from_rail,
            trk_from_rail @ arms,
        ],
        axis=2,
    )
    known = stations.base_from_flange.translation @ trk_from_rail.T
    target = stations.trk_from_tmac.translation - known
    shift, rail_axis, lever = np.split(
        np.linalg.lstsq(design.reshape(-1, 9), target.ravel(), rcond=None)[0], 3
    )
    return RobotModel(
        trk_from_rail=RigidTransform.from_components(shift, Rotation.from_matrix(trk_from_rail)),
        rail_axis=rail_axis,
        flange_from_tmac=RigidTransform.from_components(
            lever, Rotation.from_matrix(flange_from_tmac)
        ),
    )


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Give the rotation nearest to a matrix that is one but for noise and a factor of any sign."""
    u, _, vt = np.linalg.svd(np.sign(np.linalg.det(matrix)) * matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _stacked(poses: Sequence[RigidTransform]) -> RigidTransform:
    return RigidTransform.concatenate(list(poses))
