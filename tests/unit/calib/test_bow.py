from types import SimpleNamespace

import numpy as np

from tronlab.calib.camera.board import corner_points
from tronlab.calib.camera.bow import bow_basis, bowed


def test_sag_is_greatest_in_the_middle_and_nothing_at_the_edges(bench: SimpleNamespace) -> None:
    board = bench.board
    sag_x = bowed(corner_points(board), board, np.array([1e-3, 0.0, 0.0]))[:, 2]
    rows = sag_x.reshape(board.rows - 1, board.columns - 1)
    np.testing.assert_allclose(rows[:, [0, -1]], 0.0, atol=1e-18)
    np.testing.assert_allclose(rows[:, rows.shape[1] // 2], 1e-3)


def test_twist_lifts_opposite_corners(bench: SimpleNamespace) -> None:
    board = bench.board
    twist = bow_basis(corner_points(board), board)[:, 2]
    rows = twist.reshape(board.rows - 1, board.columns - 1)
    np.testing.assert_allclose(rows[[0, 0, -1, -1], [0, -1, 0, -1]], [1.0, -1.0, -1.0, 1.0])


def test_a_bow_moves_corners_across_the_board_alone(bench: SimpleNamespace) -> None:
    flat = corner_points(bench.board)
    moved = bowed(flat, bench.board, np.array([1e-3, -2e-3, 5e-4]))
    np.testing.assert_array_equal(moved[:, :2], flat[:, :2])
    assert (flat[:, 2] == 0).all()
