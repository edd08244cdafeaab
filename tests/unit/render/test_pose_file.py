from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.pose_file import read_poses, write_poses
from tronlab.render.renderer import RenderError


def values_of(path: Path) -> list[list[float]]:
    lines = [line.split("#")[0].split() for line in path.read_text().splitlines()]
    return [[float(value) for value in line] for line in lines if line]


def test_blenders_frame_has_the_cameras_y_and_z_reversed(tmp_path: Path) -> None:
    # Paper, Fig. 4: a quaternion of Blender turns (0, 0, -1) to where the camera looks and
    # (0, 1, 0) to the top of its image.
    pose = pose_along_boresight([1, 2, 3], boresight=[0.8, 0.1, -0.6], right=[0, 1, 0])
    write_poses(tmp_path / "poses.txt", [pose])
    (line,) = values_of(tmp_path / "poses.txt")
    w, x, y, z = line[3:]
    blender = Rotation.from_quat([x, y, z, w])
    assert line[:3] == [1, 2, 3]
    np.testing.assert_allclose(blender.apply([0, 0, -1]), pose.rotation.apply([0, 0, 1]), atol=1e-9)
    np.testing.assert_allclose(blender.apply([0, 1, 0]), pose.rotation.apply([0, -1, 0]), atol=1e-9)
    np.testing.assert_allclose(blender.apply([1, 0, 0]), pose.rotation.apply([1, 0, 0]), atol=1e-9)


def test_a_camera_above_the_origin_that_blender_has_unturned(tmp_path: Path) -> None:
    # Unturned, Blender's camera looks down with its top towards +Y_TRS.
    path = tmp_path / "poses.txt"
    path.write_text("# by hand\n\n0 0 4  1 0 0 0  # start\n")
    (pose,) = read_poses(path)
    np.testing.assert_array_equal(pose.translation, [0, 0, 4])
    np.testing.assert_allclose(pose.rotation.as_matrix(), np.diag([1, -1, -1]), atol=1e-15)


@settings(max_examples=25)
@given(
    st.lists(
        st.tuples(
            st.lists(st.floats(-100, 100), min_size=3, max_size=3),
            st.lists(st.floats(-4, 4), min_size=3, max_size=3),
        ),
        max_size=3,
    )
)
def test_poses_come_back(tmp_path_factory: pytest.TempPathFactory, parts: list) -> None:
    poses = [RigidTransform.from_components(t, Rotation.from_rotvec(r)) for t, r in parts]
    path = tmp_path_factory.mktemp("poses") / "poses.txt"
    write_poses(path, poses)
    back = read_poses(path)
    assert len(back) == len(poses)
    for pose, again in zip(poses, back, strict=True):
        np.testing.assert_array_equal(again.translation, pose.translation)
        np.testing.assert_allclose(
            again.rotation.as_matrix(), pose.rotation.as_matrix(), atol=1e-14
        )


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3 1 0 0", r"poses.txt:2: 6 values, expected 7: x y z qw qx qy qz"),
        ("1 2 3 1 0 0 zero", r"poses.txt:2: could not convert .*'zero'"),
        ("1 2 3 0.9 0 0 0", r"poses.txt:2: .*norm is 0.9"),
        ("nan 2 3 1 0 0 0", r"poses.txt:2: .*not finite"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(f"0 0 1 1 0 0 0\n{line}\n")
    with pytest.raises(RenderError, match=message):
        read_poses(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"poses: .*missing.txt cannot be read"):
        read_poses(tmp_path / "missing.txt")
