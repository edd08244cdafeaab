from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from tronlab.errors import ConfigError
from tronlab.trajectory.config import PoseFile, StraightLine
from tronlab.trajectory.poses import HEADER, camera_poses, read_poses

HEAD = ",".join(HEADER)
metres = st.floats(-10, 10, allow_nan=False)
points = st.tuples(metres, metres, metres)


def line(**changes: object) -> StraightLine:
    keys: dict[str, object] = {
        "kind": "straight_line",
        "start_trs_m": (1.0, 2.0, 4.0),
        "end_trs_m": (1.0, 2.0, 1.0),
        "n_points": 61,
    }
    return StraightLine.model_validate({**keys, **changes})


def test_line_of_the_paper() -> None:
    poses = camera_poses(line())
    assert len(poses) == 61
    np.testing.assert_allclose(poses[0].translation, [1, 2, 4])
    np.testing.assert_allclose(poses[-1].translation, [1, 2, 1])
    for pose in poses:  # x to the right (+Y), y down (+X), z into the model (-Z)
        np.testing.assert_allclose(
            pose.rotation.as_matrix(), [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12
        )


@given(start=points, end=points, n=st.integers(2, 50))
def test_poses_are_equally_spaced(
    start: tuple[float, float, float], end: tuple[float, float, float], n: int
) -> None:
    if np.allclose(start, end):
        return
    positions = np.array(
        [p.translation for p in camera_poses(line(start_trs_m=start, end_trs_m=end, n_points=n))]
    )
    np.testing.assert_allclose(positions[0], start, atol=1e-12)
    np.testing.assert_allclose(positions[-1], end, atol=1e-12)
    np.testing.assert_allclose(np.diff(positions, n=2, axis=0), 0, atol=1e-12)


def test_tilted_orientation() -> None:
    pose = camera_poses(line(n_points=1, boresight_trs=(0, 1, -1), right_trs=(0, 1, 0)))[0]
    np.testing.assert_allclose(
        pose.rotation.apply([0, 0, 1]), np.array([0, 1, -1]) / np.sqrt(2), atol=1e-12
    )
    assert pose.rotation.apply([1, 0, 0])[1] > 0.7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_points": 0}, "greater than or equal to 1"),
        ({"end_trs_m": (1.0, 2.0, 4.0)}, "are the same point"),
        ({"boresight_trs": (0, 0, 0)}, "boresight: is zero"),
        ({"right_trs": (0, 0, 3)}, "'right' is parallel to the boresight"),
    ],
)
def test_impossible_line_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        line(**changes)


def test_file_gives_poses_in_order(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"# a comment\n{HEAD}\n1,2,3,0,0,0,1\n\n 1.5, 2, 3, 0.6, 0.8, 0, 0\n")
    poses = camera_poses(PoseFile.model_construct(kind="file", path=path))
    np.testing.assert_allclose([p.translation for p in poses], [[1, 2, 3], [1.5, 2, 3]])
    turned = Rotation.from_quat([0.6, 0.8, 0, 0])
    np.testing.assert_allclose(poses[1].rotation.as_matrix(), turned.as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", f":1: the first line must be {HEAD}, got nothing"),
        ("x,y,z\n", f":1: the first line must be {HEAD}, got x,y,z"),
        (f"{HEAD}\n# nothing\n", ": trajectory is empty: no pose follows the header"),
        (f"{HEAD}\n1,2,3,0,0,0\n", ":2: expected 7 values (x,y,z,qx,qy,qz,qw), got 6"),
        (f"{HEAD}\n1,2,3,0,0,0,1\n1,two,3,0,0,0,1\n", ":3: y: not a number: 'two'"),
        (f"{HEAD}\n1,2,nan,0,0,0,1\n", ":2: z: must be finite, got nan"),
        (f"{HEAD}\n1,2,3,0,0,0,2\n", ":2: pose: the quaternion's norm is 2, expected 1"),
    ],
)
def test_bad_file_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_poses(path)
    assert str(caught.value) == f"{path}{message}"


def test_every_bad_line_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEAD}\n1\n1,2,3,0,0,0,1\n1,2,3,0,0,0,0\n")
    with pytest.raises(ConfigError) as caught:
        read_poses(path)
    assert [text.split(": ")[0] for text in str(caught.value).splitlines()] == [
        f"{path}:2",
        f"{path}:4",
    ]
