import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tronlab.planning.barriers import meet, meet_box
from tronlab.planning.collision import Box, Capsule
from tronlab.planning.distances import Boxes, segment_to_box_m


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_way_meets_a_box_where_its_distance_is_not_positive(seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix()
    box = Boxes(rotation, rng.normal(size=3), rng.uniform(0.1, 1.0, 3))
    start, ends = rng.normal(size=3), 2.0 * rng.normal(size=(30, 3))
    distances = segment_to_box_m(start, ends, box)
    clear = np.abs(distances) > 1e-5  # by golden section, to so much
    np.testing.assert_array_equal(meet_box(start, ends, box)[clear], (distances < 0.0)[clear])


def test_a_margin_makes_solids_larger():
    start, ends = np.array([-1.0, 0.0, 0.35]), np.array([[1.0, 0.0, 0.35]])
    bar = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    solids = [
        Capsule("link", *bar, 0.3),
        Box("plate", Boxes(np.eye(3), np.zeros(3), np.array([0.3, 0.3, 0.3]))),
    ]
    for solid in solids:
        barred = [bool(meet(start, ends, solid, margin_m=m)[0]) for m in (0.0, 0.04, 0.06)]
        assert barred == [False, False, True]
