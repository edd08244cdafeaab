from types import SimpleNamespace

import numpy as np
import pytest

from tronlab.calib.camera.projection import (
    INTRINSICS,
    free_intrinsics,
    intrinsics_of,
    project_with_jacobian,
    with_intrinsics,
)


def test_projection_derivatives_are_those_of_finite_differences(bench: SimpleNamespace) -> None:
    rng = np.random.default_rng(1)
    values = intrinsics_of(bench.camera)
    values[4:] += rng.uniform(0.01, 0.05, 8)
    camera = with_intrinsics(bench.camera, values)
    points = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 1.2], (20, 3))
    uv, by_point, by_intrinsics = project_with_jacobian(camera, points)
    np.testing.assert_allclose(uv, camera.project(points), atol=1e-10)
    for i, step in enumerate(1e-6 * np.eye(3)):
        slope = (camera.project(points + step) - camera.project(points - step)) / 2e-6
        np.testing.assert_allclose(by_point[:, :, i], slope, rtol=1e-6, atol=1e-4)
    for i, step in enumerate(1e-5 * np.eye(len(INTRINSICS))):
        ahead, behind = (with_intrinsics(camera, values + sign * step) for sign in (1, -1))
        slope = (ahead.project(points) - behind.project(points)) / 2e-5
        np.testing.assert_allclose(by_intrinsics[:, :, i], slope, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("pinhole", ()),
        ("radial", ("k1", "k2")),
        ("tangential", ("k1", "k2", "p1", "p2")),
        ("brown", ("k1", "k2", "p1", "p2", "k3")),
        ("rational", INTRINSICS[4:]),
    ],
)
def test_a_model_frees_focal_lengths_centre_and_its_coefficients(model, coefficients) -> None:
    assert [INTRINSICS[i] for i in free_intrinsics(model)] == [*INTRINSICS[:4], *coefficients]
