"""Tables of others: what is read, and errors that name file, row and column."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tronlab.dataset.exchange.folder_import import read_folder
from tronlab.dataset.exchange.foreign import shot_record
from tronlab.dataset.exchange.tum_import import read_tum
from tronlab.errors import DatasetError
from tronlab.geometry.camera import CameraModel

CAMERA = CameraModel(6, 4, 5.0, 5.0, 2.5, 1.5)
HEADER = "shot_id,image,x_m,y_m,z_m,qx,qy,qz,qw"
ROW = "1,a.png,1,2,3,0,0,0,1"
COVARIANCE = ",".join(f"cov_{i}{j}" for i in range(6) for j in range(i, 6))
NEGATIVE = ",".join(
    "-1e-9" if i == j == 3 else str(1e-9 * (i == j)) for i in range(6) for j in range(i, 6)
)


def table(folder: Path, *lines: str) -> Path:
    path = folder / "shots.csv"
    path.write_text("\n".join(lines))
    return path


def tum(folder: Path, images: str, trajectory: str) -> tuple[Path, Path]:
    paths = folder / "rgb.txt", folder / "groundtruth.txt"
    for path, text in zip(paths, (images, trajectory), strict=True):
        path.write_text(text)
    return paths


def test_the_least_table_leaves_unknown_what_it_does_not_say(tmp_path: Path) -> None:
    grey = np.arange(24, dtype=np.uint16).reshape(4, 6) * 100
    Image.fromarray(grey).save(tmp_path / "a.png")
    (shot,) = read_folder(table(tmp_path, f"{HEADER},weather", f"{ROW},fine", "")).shots
    mask = np.ones(CAMERA.shape, dtype=np.bool_)
    record = shot_record(shot, CAMERA, mask=mask, range_los_m=3.0)
    np.testing.assert_array_equal(record.frame.image, grey)
    assert record.frame.pixel_format == "Mono12"
    assert record.robot is record.tracker is record.room is shot.mask(CAMERA) is None
    assert np.isnan(record.truth.covariance).all()
    assert np.isnan([record.frame.time_s, record.frame.exposure_s, record.frame.gain_db]).all()
    np.testing.assert_array_equal(record.trs_from_cam_nominal.translation, [1, 2, 3])


def test_colours_become_their_luma_and_other_sizes_are_refused(tmp_path: Path) -> None:
    Image.new("RGB", (6, 4), (200, 100, 50)).save(tmp_path / "a.png")
    Image.new("L", (4, 6)).save(tmp_path / "b.png")
    (tmp_path / "c.png").write_bytes(b"no image")
    lines = [HEADER, *(f"{i},{name}.png,1,2,3,0,0,0,1" for i, name in enumerate("abcd"))]
    shots = read_folder(table(tmp_path, *lines)).shots
    luma = 0.299 * 200 + 0.587 * 100 + 0.114 * 50
    np.testing.assert_allclose(shots[0].image(CAMERA), luma, atol=1.0)
    for shot, message in zip(
        shots[1:],
        (
            r"shots\.csv:3: .*b\.png: has 4 x 6 pixels, the camera 6 x 4",
            r"shots\.csv:4: .*c\.png: is no image that can be read; expected PNG",
            r"shots\.csv:5: .*d\.png: No such file or directory",
        ),
        strict=True,
    ):
        with pytest.raises(DatasetError, match=message):
            shot.image(CAMERA)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["shot_id,image", "1,a.png"], r"csv:1: no column x_m, y_m, z_m, qx, qy, qz, qw; the fi"),
        ([HEADER], r"shots\.csv: has no rows below its header"),
        ([], r"csv:1: no column shot_id, image"),
        ([f"{HEADER},image", f"{ROW},b.png"], "csv:1: columns that are there twice: image"),
        ([HEADER, f"{ROW},4"], "csv:2: 10 cells, but there are 9 columns"),
        ([HEADER, ROW.replace("1,a", "1.5,a")], "csv:2: shot_id: '1.5' is no whole number"),
        ([HEADER, ROW.replace("1,a", "-3,a")], "csv:2: shot_id is -3, must be 0 or more"),
        ([HEADER, ROW.replace("a.png", "")], "csv:2: image is empty"),
        ([HEADER, ROW, "", ROW], r"csv: shot_id must be unique; more than once: 1"),
        ([HEADER, ROW.replace("2", "two")], "csv:2: y_m: 'two' is not a number"),
        ([HEADER, ROW.replace("2", "inf")], "csv:2: y_m: inf is not finite"),
        ([HEADER, "1,a.png,,,,,,,"], "csv:2: has no pose: x_m, "),
        ([HEADER, "1,a.png,1,2,3,1,0,0,"], "csv:2: qw: empty; give all of x_m, y_m"),
        ([HEADER, ROW.replace("0,0,0", "0,0,1")], r"csv:2: the quaternion .* norm 1\.414214"),
        ([f"{HEADER},range_los_m", f"{ROW},0"], "csv:2: range_los_m is 0, must be above 0"),
        ([f"{HEADER},cov_00", f"{ROW},1e-9"], "csv:2: cov_01, cov_02, .*: empty"),
        ([f"{HEADER},{COVARIANCE}", f"{ROW},{NEGATIVE}"], "csv:2: cov_00 to cov_55 are no covaria"),
        ([f"{HEADER},nominal_x_m", f"{ROW},1"], "csv:2: nominal_y_m, .* empty; give all of"),
    ],
)
def test_mistakes_in_a_table_are_named(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        read_folder(table(tmp_path, *lines))


def test_tables_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"none\.csv: No such file or directory"):
        read_folder(tmp_path / "none.csv")
    (tmp_path / "old.csv").write_bytes(b"shot_id\rimage\r")
    with pytest.raises(DatasetError, match=r"old\.csv:1: is no CSV: new-line character"):
        read_folder(tmp_path / "old.csv")
    (tmp_path / "odd.csv").write_bytes(b"shot_id\n\xff")
    with pytest.raises(DatasetError, match=r"odd\.csv: is not UTF-8 text \(byte 8\)"):
        read_folder(tmp_path / "odd.csv")


def test_an_image_takes_the_nearest_pose_and_how_far_off_it_is_told(tmp_path: Path) -> None:
    images = "# images\n10.0 rgb/a.png\n11.0 rgb/b.png\n12.0 rgb/c.png\n"
    trajectory = "\n".join(f"{t} {t} 0 0 0 0 0 1" for t in (9.5, 10.51, 11.496, 14.0))
    paths = tum(tmp_path, images, trajectory.replace(" ", ", ", 1))
    foreign = read_tum(*paths, offset_s=-0.5)
    assert [shot.shot_id for shot in foreign.shots] == [1, 2]
    assert [shot.trs_from_cam.translation[0] for shot in foreign.shots] == [10.51, 11.496]
    assert [shot.time_s for shot in foreign.shots] == [10.0, 11.0]
    assert foreign.shots[0].image_path == tmp_path / "rgb/a.png"
    (note,) = foreign.notes
    assert note.startswith("2 of 3 images have a pose within 0.02 s")
    assert "by 10.000 ms at most, nothing was interpolated" in note


@pytest.mark.parametrize(
    ("images", "trajectory", "message"),
    [
        ("1.0 a.png", "1.0 0 0 0 0 0 1", r"truth\.txt:1: 7 columns, expected timestamp tx ty tz"),
        ("1.0", "1.0 0 0 0 0 0 0 1", r"rgb\.txt:1: 1 columns, expected timestamp filename"),
        ("1.0 a.png", "#\n1.0 0 0 0 0 0 0 2", r"truth\.txt:2: the quaternion .* norm 2\.000000"),
        ("1.0 a.png", "#\n", r"truth\.txt: has no poses"),
        ("x a.png", "1.0 0 0 0 0 0 0 1", r"rgb\.txt:1: 'x' is not a number"),
        ("1.0 a.png", "2.0 0 0 0 0 0 0 1", r"none of 1 images has a pose in .* within 0\.02 s"),
    ],
)
def test_mistakes_in_tum_files_are_named(
    tmp_path: Path, images: str, trajectory: str, message: str
) -> None:
    with pytest.raises(DatasetError, match=message):
        read_tum(*tum(tmp_path, images, trajectory))
