import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import FrameError
from tronlab.geometry.frames import FrameGraph


def random_pose(rng):
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


@pytest.fixture
def chain():
    """The chain of the paper's Fig. 3: trs - trk - tmac - cam."""
    rng = np.random.default_rng(3)
    names = ["trs", "trk", "tmac", "cam"]
    edges = [random_pose(rng) for _ in range(3)]
    graph = FrameGraph()
    for a, b, a_from_b in zip(names, names[1:], edges, strict=False):
        graph.add(a, b, a_from_b)
    return graph, edges


def test_a_path_is_the_product_of_its_edges(chain):
    graph, (trs_from_trk, trk_from_tmac, tmac_from_cam) = chain
    expected = trs_from_trk * trk_from_tmac * tmac_from_cam
    np.testing.assert_allclose(
        graph.get("trs", "cam").as_matrix(), expected.as_matrix(), atol=1e-12
    )


def test_the_way_back_is_the_inverse(chain):
    graph, _ = chain
    round_trip = graph.get("cam", "trs") * graph.get("trs", "cam")
    np.testing.assert_allclose(round_trip.as_matrix(), np.eye(4), atol=1e-12)


def test_a_frame_relative_to_itself_is_the_identity(chain):
    np.testing.assert_array_equal(chain[0].get("cam", "cam").as_matrix(), np.eye(4))


def test_a_loop_that_closes_is_accepted(chain):
    graph, _ = chain
    graph.add("cam", "trs", graph.get("cam", "trs"))
    assert graph.frames == ("cam", "tmac", "trk", "trs")


def test_a_loop_that_does_not_close_is_an_error_that_names_gap_and_loop(chain):
    graph, _ = chain
    off = graph.get("trs", "cam") * RigidTransform.from_translation([0, 0, 0.002])
    with pytest.raises(FrameError, match=r"loop trs -> trk -> tmac -> cam -> trs .* 2 mm"):
        graph.add("trs", "cam", off)


def test_a_loop_turned_too_far_is_an_error(chain):
    graph, _ = chain
    turned = graph.get("trs", "cam") * RigidTransform.from_rotation(
        Rotation.from_rotvec([0, 0, 1e-3])
    )
    with pytest.raises(FrameError, match="1 mrad"):
        graph.add("trs", "cam", turned)


def test_the_loop_tolerance_can_be_the_laboratorys():
    graph = FrameGraph(tolerance_m=1e-3, tolerance_rad=1e-3)
    graph.add("trs", "cam", RigidTransform.identity())
    graph.add("trs", "cam", RigidTransform.from_translation([0, 0, 5e-4]))
    np.testing.assert_allclose(graph.get("trs", "cam").translation, [0, 0, 5e-4])


def test_an_unknown_frame_is_named_with_the_known_ones(chain):
    with pytest.raises(FrameError, match="'cma': unknown; known frames: cam, tmac, trk, trs"):
        chain[0].get("trs", "cma")


def test_frames_without_a_path_are_named(chain):
    graph, _ = chain
    graph.add("rail", "base", RigidTransform.identity())
    with pytest.raises(FrameError, match="no path between frame 'trs' and frame 'base'"):
        graph.get("trs", "base")


def test_a_frame_cannot_be_its_own_parent():
    with pytest.raises(FrameError, match="relative to itself"):
        FrameGraph().add("trs", "trs", RigidTransform.identity())
