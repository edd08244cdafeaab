import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, pose_along_boresight
from tronlab.planning.collision import Box, Capsule, Solid
from tronlab.planning.distances import Boxes
from tronlab.planning.light import Light, light_findings, light_on_view
from tronlab.render.renderer import PLAIN, Lamp, Rendering

CAMERA = CameraModel(300, 300, 300.0, 300.0, 149.5, 149.5)
ABOVE = pose_along_boresight((0.0, 0.0, 2.0), boresight=(0, 0, -1), right=(0, 1, 0))
"""It sees 2 m x 2 m of the plane z = 0."""
LAMP = np.array([0.0, 0.0, 3.0])
NONE: tuple[Solid, ...] = ()


def capsule(p0, p1, radius_m: float) -> Capsule:
    return Capsule("link", np.array(p0), np.array(p1), radius_m)


class Plane:
    """Renders z = 0, lit where x is below a limit."""

    def __init__(self, lit_below_x_m: float = np.inf) -> None:
        self._lit_below_x_m = lit_below_x_m

    def render(self, camera, trs_from_cam, lamp, settings=PLAIN):
        rays = np.dstack([camera.ray_table(), np.ones(camera.shape)])
        directions = rays @ trs_from_cam.rotation.as_matrix().T
        depth = np.full(camera.shape, -trs_from_cam.translation[2]) / directions[..., 2]
        depth[depth < 0] = np.nan
        points = trs_from_cam.translation + depth[..., None] * directions
        return Rendering(
            radiance=np.ones(camera.shape, np.float32),
            depth_m=depth.astype(np.float32),
            points_trs_m=points.astype(np.float32),
            is_lit=points[..., 0] < self._lit_below_x_m,
        )


def light(robot, *, plane: Plane | None = None, pose=ABOVE, lamp: FloatArray = LAMP):
    return light_on_view(
        pose, renderer=plane or Plane(), camera=CAMERA, lamp=Lamp(lamp, intensity=1.0), robot=robot
    )


def test_without_a_robot_the_terrain_alone_makes_the_dark():
    assert light(NONE) == Light(lit_fraction=1.0, robot_shadow=0.0)
    half = light(NONE, plane=Plane(lit_below_x_m=0.0))
    assert half.lit_fraction == pytest.approx(0.5, abs=0.01)
    assert half.robot_shadow == 0.0


def test_a_ball_throws_the_shadow_of_a_cone():
    """The cone from the lamp that touches a ball at distance d has the half angle asin(r / d)."""
    ball = capsule((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.3)
    radius_m = 3.0 * np.tan(np.arcsin(0.3 / 2.0))
    found = light([ball])
    assert found.robot_shadow == pytest.approx(np.pi * radius_m**2 / 4.0, rel=0.02)
    assert found.lit_fraction == pytest.approx(1.0 - found.robot_shadow)


def test_a_plate_throws_the_shadow_of_its_face_next_to_the_lamp():
    plate = Boxes(np.eye(3), np.array([0.0, 0.0, 0.9]), np.array([0.3, 0.3, 0.1]))
    scale = 3.0 / 2.0  # by the upper face, at 1 m; the lower one is farther from the lamp
    expected = (0.6 * scale) ** 2 / 4.0
    found = light([Box("plate", plate)]).robot_shadow
    assert found == pytest.approx(
        expected, rel=2 / 29
    )  # 29 samples wide, edges known to half of one


def test_what_the_terrain_darkens_is_no_shadow_of_the_robot():
    ball = capsule((0.5, 0.0, 1.0), (0.5, 0.0, 1.0), 0.1)
    assert light([ball], plane=Plane(lit_below_x_m=0.0)).robot_shadow == 0.0


def test_a_robot_behind_the_lamp_or_beside_it_bars_nothing():
    behind = capsule((0.0, 0.0, 3.5), (1.0, 0.0, 3.5), 0.2)
    beside = capsule((3.0, 3.0, 0.0), (3.0, 3.0, 3.0), 0.5)
    assert light([behind, beside]).robot_shadow == 0.0


def test_nothing_in_view_is_no_finding():
    away = pose_along_boresight((0.0, 0.0, 2.0), boresight=(0, 0, 1), right=(0, 1, 0))
    found = light(NONE, pose=away)
    assert np.isnan([found.lit_fraction, found.robot_shadow]).all()
    assert not light_findings(found, min_lit_fraction=0.1, max_robot_shadow=0.0)


def test_findings_name_value_and_limit():
    findings = light_findings(
        Light(lit_fraction=0.031, robot_shadow=0.25), min_lit_fraction=0.05, max_robot_shadow=0.02
    )
    assert [finding.text for finding in findings] == [
        "the lamp lights 3.1 % of the visible model, at least 5 % is wanted",
        "the robot keeps the lamp from 25.0 % of the visible model, allowed 2 %",
    ]
    assert all(finding.check == "light" and finding.is_refusal for finding in findings)
