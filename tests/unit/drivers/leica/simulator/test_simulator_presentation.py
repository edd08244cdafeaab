"""Coordinates, units and air of the simulated tracker, without any wire."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.leica.simulator.presentation import Presentation, hvd_of, point_of_hvd
from drivers.leica.simulator.refraction import adm_index, ifm_index
from drivers.leica.simulator.units import Units
from tronlab.devices.readings import AirReading

USER_FROM_TRK = RigidTransform.from_components([0.3, -1.2, 0.4], Rotation.from_rotvec([0.2, 1, 3]))
MILLIMETRES_GON = Units(1, 2, 0, 0, 0)
COVARIANCE_M2 = np.array([[4.0, 1.0, -0.5], [1.0, 3.0, 0.2], [-0.5, 0.2, 5.0]]) * 1e-10
coordinates = st.floats(0.2, 8.0) | st.floats(-8.0, -0.2)
FEW = settings(max_examples=25, deadline=None, derandomize=True)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def presentation(kind: int) -> Presentation:
    return Presentation(MILLIMETRES_GON, kind, USER_FROM_TRK, 1.25)


@pytest.mark.parametrize("kind", range(8))
@FEW
@given(p_m=points)
def test_points_come_back(kind, p_m):
    shown = presentation(kind)
    assert shown.point_trk(shown.point(p_m)) == pytest.approx(p_m, abs=1e-12)


@pytest.mark.parametrize("kind", range(8))
def test_covariance_is_that_of_many_points(kind, rng):
    """Propagated to first order, against a sample of small deviations."""
    shown = presentation(kind)
    p_m = np.array([2.0, -1.5, 0.7])
    deviations = rng.multivariate_normal(np.zeros(3), COVARIANCE_M2, 5_000)
    sample = np.cov(np.array([shown.point(p_m + each) for each in deviations]).T)
    expected = shown.covariance(p_m, COVARIANCE_M2)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert sample / scale == pytest.approx(expected / scale, abs=0.07)


def test_rotation_covariance_turns_with_the_axes():
    quarter = RigidTransform.from_rotation(Rotation.from_rotvec([0, 0, np.pi / 2]))
    shown = Presentation(Units(0, 1, 0, 0, 0), 0, quarter, 1.0)
    turned = shown.rotation_covariance(np.diag([1.0, 4.0, 9.0]))
    assert turned == pytest.approx(np.diag([4.0, 1.0, 9.0]) * np.degrees(1) ** 2, abs=1e-9)


def test_hvd_is_clockwise_from_y_and_down_from_z():
    assert hvd_of(np.array([1.0, 0.0, 0.0])) == pytest.approx((np.pi / 2, np.pi / 2, 1.0))
    assert hvd_of(np.array([0.0, 2.0, 0.0])) == pytest.approx((0.0, np.pi / 2, 2.0))
    assert hvd_of(np.array([0.0, 0.0, -3.0]))[1:] == pytest.approx((np.pi, 3.0))
    assert hvd_of(np.zeros(3)) == (0.0, 0.0, 0.0)


@FEW
@given(p_m=points)
def test_hvd_comes_back(p_m):
    assert point_of_hvd(*hvd_of(p_m)) == pytest.approx(p_m, abs=1e-12)


def test_refraction_agrees_with_tabled_values():
    """n - 1 by NIST's equations: 271.377e-6 (632.8 nm), 274.86e-6 (group, 795 nm); its slopes."""

    def index(temperature_k=293.15, pressure_pa=101_325.0, relative_humidity=0.5) -> AirReading:
        return AirReading(temperature_k, pressure_pa, relative_humidity)

    usual = ifm_index(index())
    assert usual - 1 == pytest.approx(271.377e-6, abs=0.005e-6)
    assert adm_index(index()) - 1 == pytest.approx(274.86e-6, abs=0.01e-6)
    assert ifm_index(index(temperature_k=294.15)) - usual == pytest.approx(-0.952e-6, abs=0.01e-6)
    assert ifm_index(index(pressure_pa=101_425.0)) - usual == pytest.approx(0.268e-6, abs=0.001e-6)
    assert ifm_index(index(relative_humidity=0.6)) - usual == pytest.approx(-0.085e-6, abs=0.002e-6)
