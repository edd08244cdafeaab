import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.cell import SightSpec
from tronlab.planning.sight import Sight, sight_findings, sight_of, terrain_in_beam
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.terrain.heightmap import HeightMap

TRACKER = np.array([0.0, 4.0, 1.0])
LOOKS_ALONG_X = SightSpec(tmac_axis=(2.0, 0.0, 0.0))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 180.0])
def test_distance_and_angle_are_those_of_the_beam(angle_deg):
    towards_tracker = Rotation.from_euler("z", 90.0 + angle_deg, degrees=True)
    trs_from_tmac = RigidTransform.from_components([0.0, 1.0, 1.0], towards_tracker)
    sight = sight_of(TRACKER, trs_from_tmac, LOOKS_ALONG_X)
    assert sight.distance_m == pytest.approx(3.0)
    assert np.degrees(sight.angle_rad) == pytest.approx(angle_deg, abs=1e-9)


def test_an_axis_nobody_named_is_not_judged():
    sight = sight_of(TRACKER, RigidTransform.identity(), SightSpec())
    assert np.isnan(sight.angle_rad)
    assert not sight_findings(sight, SightSpec())


def test_findings_name_value_and_limit():
    sight = Sight(distance_m=20.0, angle_rad=np.radians(50.0))
    assert [finding.text for finding in sight_findings(sight, LOOKS_ALONG_X)] == [
        "the T-MAC is 20.00 m from the tracker, allowed 1.5 to 15 m",
        "the beam comes 50.0 deg off the T-MAC's axis, allowed 45 deg",
    ]


@pytest.mark.parametrize(
    "values", [{"tmac_axis": (0.0, 0.0, 0.0)}, {"range_m": (15.0, 1.5)}], ids=["axis", "range"]
)
def test_a_cell_that_makes_no_sense_is_refused(values):
    with pytest.raises(ValidationError, match=r"is zero|must be below"):
        SightSpec(**values)


def test_a_ridge_bars_the_beam_that_does_not_clear_it_by_its_radius():
    heights = np.zeros((11, 31), np.float32)
    heights[:, 15] = 0.5  # at y = 1.5 m
    renderer = HeightfieldRenderer(HeightMap(heights, 0.1, np.zeros(3)), n_threads=1)

    def is_barred(height_m: float) -> bool:
        return terrain_in_beam(
            np.array([0.5, 4.0, height_m]),
            np.array([0.5, 0.5, height_m]),
            beam_radius_m=0.03,
            range_finder=renderer,
        )

    assert [is_barred(z) for z in (0.3, 0.48, 0.52, 0.54, 1.0)] == [True, True, True, False, False]
