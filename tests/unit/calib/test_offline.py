"""Recorded files: what is understood, and errors that name file and row."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye.pose_pairs import solve_pose_pairs
from tronlab.calib.inputs import Inputs, PosePairsInput, StationsInput
from tronlab.calib.offline import read_camera, read_hand_eye, read_intrinsics
from tronlab.calib.solve import solve
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.uncertainty import pose_difference

pytestmark = pytest.mark.opencv

DATA = Path(__file__).parents[3].parent / "shared/data"
CHESSBOARD = PatternSpec(kind="chessboard", columns=10, rows=7, square_m=0.025)


def data(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"no {DATA / name}")
    return DATA / name


def read(*paths: Path, **options: object) -> StationsInput | PosePairsInput:
    return read_hand_eye(paths, **{"pattern": None, "camera": None, **options})  # type: ignore[arg-type]


def test_moveits_pairs_give_the_answer_of_their_own_test() -> None:
    pairs = read(data("moveit_handeye/pose_samples.json"), setup="eye_to_hand")
    assert isinstance(pairs, PosePairsInput)
    assert list(pairs.files_sha256) == ["pose_samples.json"]
    result = solve_pose_pairs(pairs)
    expected = Rotation.from_euler("XYZ", [0.230, -2.540, 1.950])
    np.testing.assert_allclose(result.tmac_from_cam.translation, [0.659, -0.249, 0.830], rtol=0.01)
    assert (expected.inv() * result.tmac_from_cam.rotation).magnitude() < 0.01
    assert result.statistics["warnings"] == []


def test_visps_images_give_the_published_pose() -> None:
    folder = data("visp_franka_eye_in_hand/data-eye-in-hand")
    stations = read(folder)
    assert isinstance(stations, StationsInput)
    assert stations.is_camera_known
    result = solve(Inputs(hand_eye=stations)).hand_eye
    assert result is not None
    published = RigidTransform.from_components(
        [0.05771519632, -0.03392488515, -0.04227690244],
        Rotation.from_rotvec([0.001783530191, 0.009173747947, 1.581782359]),
    )
    difference = pose_difference(result.tmac_from_cam, published)
    assert np.linalg.norm(difference[3:]) < 1e-3
    assert np.linalg.norm(difference[:3]) < np.radians(0.2)
    assert any("closed form andreff lies 8." in line for line in result.statistics["warnings"])


@pytest.mark.timeout(600)
def test_eths_streams_give_offset_and_scatter() -> None:
    pairs = read(data("ethz_handeye/prime_sense_color_w_vicon_1.zip"))
    assert isinstance(pairs, PosePairsInput)
    notes = "\n".join(pairs.notes)
    assert "5 repeated time stamps left out" in notes
    assert "vicon_prime_sense.csv starts 1.3" in notes
    offset_ms = float(notes.split("tracker + (")[1].split()[0])
    assert offset_ms == pytest.approx(-15, abs=5)
    assert solve_pose_pairs(pairs).statistics["target_scatter_m"] < 8.4e-3


def test_cameras_of_opencv_and_visp_are_read() -> None:
    opencv = read_camera(data("opencv_calib/left_intrinsics.yml"))
    assert (opencv.width_px, opencv.height_px) == (640, 480)
    assert opencv.fx_px == pytest.approx(535.91573)
    assert opencv.distortion[:5] == pytest.approx(
        (-0.26637, -0.03859, 0.00178, -0.00028, 0.23839), abs=1e-5
    )
    visp = read_camera(data("visp_franka_eye_in_hand/data-eye-in-hand/franka_camera.xml"))
    assert (visp.fx_px, visp.cy_px) == pytest.approx((607.59314, 243.25529))


def draw_chessboard(path: Path, *, size: tuple[int, int] = (640, 480)) -> None:
    image = np.full((size[1], size[0]), 255, np.uint8)
    for row in range(7):
        for column in range(10):
            if (row + column) % 2 == 0:
                x, y = 60 + 40 * column, 60 + 40 * row
                image[y : y + 40, x : x + 40] = 20
    cv2.imwrite(str(path), image)


def test_images_without_a_board_are_listed_and_the_others_hashed(tmp_path: Path) -> None:
    draw_chessboard(tmp_path / "b.png")
    cv2.imwrite(str(tmp_path / "a.png"), np.full((480, 640), 90, np.uint8))
    found = read_intrinsics([tmp_path], pattern=CHESSBOARD, nominal_focal_px=700.0)
    assert found.skipped == ("a.png: no board found",)
    assert [view.image for view in found.views] == ["b.png"]
    assert len(found.views[0].image_sha256) == 64
    assert found.nominal.fx_px == 700.0
    corners = np.array(found.views[0].uv_px)
    assert np.abs(corners - np.round(corners / 20) * 20 + 0.5).max() < 0.1


def test_images_of_two_sizes_are_refused_by_name(tmp_path: Path) -> None:
    draw_chessboard(tmp_path / "a.png")
    draw_chessboard(tmp_path / "b.png", size=(800, 600))
    with pytest.raises(CalibrationError, match=r"a\.png 640 x 480, b\.png 800 x 600"):
        read_intrinsics([tmp_path], pattern=CHESSBOARD)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.json", "[[1, 2, 3]]", "expected a list of pairs"),
        ("x.json", "[", r"x\.json:1: not JSON"),
        ("t.csv", "0,1,2,3,0,0,0,1\n0.1,1,2,3,0,0,1", r"t\.csv:2: 7 columns, expected t,x,y,z"),
        ("t.csv", "t,x,y,z,a,b,c,d\n0,1,2,3,0,0,0,2", r"t\.csv:2: the quaternion .* norm 2\.0000"),
        ("t.csv", "0,1,2,3,0,0,0,1\n0.1,1,up,3,0,0,0,1", r"t\.csv:2: 'up' is not a number"),
        ("t.csv", "0,1,2,3,0,0,0,1", r"1 streams of poses \(t\.csv\), expected two"),
        ("t.zip", "PK", "no zip archive"),
        ("t.doc", "", r"t\.doc: not understood; hand-eye data may be\n  FOLDER"),
    ],
)
def test_files_that_are_none_are_refused_with_file_and_row(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(CalibrationError, match=message):
        read(tmp_path / name)


def test_a_left_handed_frame_is_refused_by_its_pair(tmp_path: Path) -> None:
    good, mirrored = np.eye(4).tolist(), np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps([[good, good], [good, mirrored]]))
    with pytest.raises(CalibrationError, match=r"pair 1, board: .*left-handed"):
        read(path)


def test_a_missing_path_an_empty_folder_and_a_missing_image_are_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="nowhere: no such file or folder"):
        read(tmp_path / "nowhere")
    with pytest.raises(CalibrationError, match="not understood"):
        read(tmp_path)
    (tmp_path / "poses.csv").write_text("image,x,y,z,qx,qy,qz,qw\na.png,0,0,0,0,0,0,1\n")
    with pytest.raises(CalibrationError, match="board is not known"):
        read(tmp_path)
    with pytest.raises(CalibrationError, match=r"a\.png: no such file, but it has a pose"):
        read(tmp_path, pattern=CHESSBOARD)


def test_a_camera_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    path.write_text("focal: 3\n")
    with pytest.raises(CalibrationError, match=r"camera\.yml: is no camera file; understood are"):
        read_camera(path)
    path.write_text("%YAML:1.0\n---\ncamera_matrix: 3\n")
    with pytest.raises(CalibrationError, match=r"camera\.yml: "):
        read_camera(path)
    path.write_text("<camera_matrix>")
    with pytest.raises(CalibrationError, match=r"camera\.yml: OpenCV cannot read a camera"):
        read_camera(path)
    path.write_text(
        "%YAML:1.0\n---\nimage_width: 4\nimage_height: 3\ncamera_matrix: !!opencv-matrix\n"
        "   rows: 3\n   cols: 3\n   dt: d\n   data: [-7., 0., 2., 0., 7., 1., 0., 0., 1.]\n"
    )
    with pytest.raises(CalibrationError, match=r"focal lengths -7 and 7 px, both must be above 0"):
        read_camera(path)
