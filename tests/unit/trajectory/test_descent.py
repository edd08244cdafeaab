import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pydantic import ValidationError

from tronlab.errors import ConfigError, DatasetError
from tronlab.trajectory.config import PoweredDescent
from tronlab.trajectory.descent import Descent, fly
from tronlab.trajectory.files import check_out, write_poses, write_states
from tronlab.trajectory.guidance import land
from tronlab.trajectory.poses import camera_poses, read_poses, trajectory_numbers
from tronlab.trajectory.summary import describe_descents, poses_by_trajectory

pytest.importorskip("clarabel")

BASE: dict[str, Any] = {
    "kind": "powered_descent",
    "landing_point_trs_m": (0.95, 2.30, 0.1),
    "sampling": {"spacing_m": 0.42, "height_m": (0.5, 5.45)},
}
LIKE_THE_PAPER = {"n": 2, "seed": 1}


def config(**changes: Any) -> PoweredDescent:
    return PoweredDescent.model_validate({**BASE, **changes})


def one(section: PoweredDescent) -> Descent:
    (descent,) = fly(section).trajectories
    return descent


def test_nominal_descent_in_the_laboratory() -> None:
    section = config()
    descent = one(section)
    assert descent.number == 0
    assert descent.is_tight
    positions = np.array([pose.translation for pose in camera_poses(section)])
    heights = positions[:, 2] - 0.1
    assert np.all((heights >= 0.5) & (heights <= 5.45))
    assert np.all(np.diff(heights) < 0)  # flown downwards
    apart = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert np.all((apart > 0.419) & (apart < 0.42 + 1e-5))
    assert trajectory_numbers(section) == (0,) * len(positions)


def test_camera_looks_against_the_thrust() -> None:
    descent = one(config(right_trs=(1.0, 1.0, 0.0)))
    flight = descent.flight
    for time_s, pose in zip(descent.sampled_time_s, descent.trs_from_cam, strict=True):
        along = np.array(
            [np.interp(time_s, flight.time_s, u) for u in flight.acceleration_m_per_s2.T]
        )
        boresight = pose.rotation.apply([0, 0, 1])
        np.testing.assert_allclose(boresight, -along / np.linalg.norm(along), atol=1e-9)
        right = pose.rotation.apply([1, 0, 0])
        assert right @ (np.array([1, 1, 0]) / np.sqrt(2)) > np.cos(np.radians(10.01))


def test_heading_turns_and_landing_point_moves_everything() -> None:
    plain, turned = (
        camera_poses(config(heading_deg=heading, right_trs=right, landing_point_trs_m=point))
        for heading, right, point in (
            (0.0, (0, 1, 0), (0.95, 2.30, 0.1)),
            (90.0, (-1, 0, 0), (5.0, 6.0, 0.3)),
        )
    )
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for a, b in zip(plain, turned, strict=True):
        moved = quarter @ (a.translation - [0.95, 2.30, 0.1]) + [5.0, 6.0, 0.3]
        np.testing.assert_allclose(b.translation, moved, atol=1e-9)
        np.testing.assert_allclose(
            b.rotation.as_matrix(), quarter @ a.rotation.as_matrix(), atol=1e-9
        )


def test_points_do_not_depend_on_the_window() -> None:
    whole = np.array(
        [
            p.translation
            for p in camera_poses(config(sampling={"spacing_m": 0.42, "height_m": (0, 99)}))
        ]
    )
    np.testing.assert_allclose(whole[-1], BASE["landing_point_trs_m"], atol=1e-4)
    for pose in camera_poses(config()):
        assert np.min(np.linalg.norm(whole - pose.translation, axis=1)) < 1e-12


def test_a_perturbed_trajectory_is_the_same_alone() -> None:
    together = fly(config(perturbed=LIKE_THE_PAPER))
    alone = one(config(perturbed={**LIKE_THE_PAPER, "n": 20, "only": [2]}))
    same = together.trajectories[1]
    assert (alone.number, alone.start) == (2, same.start)
    assert [p.as_matrix().tolist() for p in alone.trs_from_cam] == [
        p.as_matrix().tolist() for p in same.trs_from_cam
    ]
    again = land.__wrapped__(same.start, config().lander)  # not the one that was kept
    assert again is not None
    np.testing.assert_array_equal(again.position_m, same.flight.position_m)
    assert together.nominal.number == 0
    for descent in together.trajectories:
        offset_m = np.subtract(descent.start.position_m, together.nominal.start.position_m)
        change = np.subtract(
            descent.start.velocity_m_per_s, together.nominal.start.velocity_m_per_s
        )
        assert np.all(np.abs(offset_m) <= 100)
        assert np.all(np.abs(change) <= 10)
    numbers = trajectory_numbers(config(perturbed=LIKE_THE_PAPER))
    assert set(numbers) == {1, 2}
    assert list(numbers) == sorted(numbers)
    assert len(numbers) == len(camera_poses(config(perturbed=LIKE_THE_PAPER)))


def test_starts_without_a_descent_are_told_and_drawn_anew() -> None:
    section = config(perturbed={"n": 1, "seed": 32, "position_m": 600, "velocity_m_per_s": 1})
    descents = fly(section)
    assert [start.number for start in descents.rejected] == [1]
    text = describe_descents(descents)
    for start in descents.rejected:
        assert start.reason in text
        assert f"trajectory {start.number}: drawn anew" in text
    assert "below min_glide_slope_deg 60" in text
    assert descents.trajectories[0].start != descents.rejected[0].start


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"start": {"velocity_m_per_s": (0, 0, -120)}},
            "trajectory.start: there is no descent from here: in the way is thrust_n[1] 8000",
        ),
        (
            {"sampling": {"spacing_m": 0.4, "height_m": (40, 50)}},
            "trajectory.sampling: no point of any trajectory is 40 to 50 m above the landing point",
        ),
        (
            {"perturbed": {"n": 1, "seed": 1, "position_m": 1e5}},
            "trajectory.perturbed: trajectory 1: there is no descent from any of 2 starts drawn",
        ),
    ],
)
def test_what_cannot_be_flown_is_one_clear_error(
    changes: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tronlab.trajectory.descent.MAX_DRAWS", 2)
    with pytest.raises(ConfigError) as caught:
        camera_poses(config(**changes))
    assert str(caught.value).startswith(message)


def test_missing_solver_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(ConfigError, match=r"pip install 'tronlab\[trajectory\]'"):
        camera_poses(config(start={"position_m": (1, 2, 1234)}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"right_trs": (0.1, 0, 1)}, "from the vertical, where the optical axis may be"),
        ({"right_trs": (0, 0, 0)}, "right_trs: is zero"),
        ({"start": {"position_m": (0, 0, -5)}}, "must be above the landing point"),
        ({"start": {"position_m": (2000, 0, 1500)}}, "its elevation is 36.87 degrees"),
        ({"lander": {"thrust_n": (900, 800)}}, "the first value must be below the second"),
        ({"lander": {"thrust_n": (10, 1000)}}, "must exceed the weight of dry_mass_kg, 1620 N"),
        ({"lander": {"dry_mass_kg": 3000}}, "must be below mass_kg 2000"),
        ({"sampling": {"spacing_m": 1, "height_m": (2, 1)}}, "the first value must be below"),
        ({"perturbed": {"n": 3, "seed": 1, "only": [4]}}, "no trajectory 4; allowed: 1 to 3"),
        ({"perturbed": {"n": 3, "seed": 1, "only": [2, 2]}}, "a number stands twice"),
    ],
)
def test_impossible_section_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        config(**changes)


def test_files_give_back_what_was_written(tmp_path: Path) -> None:
    section = config(perturbed=LIKE_THE_PAPER)
    poses = camera_poses(section)
    by_number = poses_by_trajectory(poses, trajectory_numbers(section))
    write_poses(tmp_path / "poses.csv", by_number)
    assert "# trajectory 2\n" in (tmp_path / "poses.csv").read_text()
    for read, written in zip(read_poses(tmp_path / "poses.csv"), poses, strict=True):
        np.testing.assert_allclose(read.as_matrix(), written.as_matrix(), atol=1e-11)

    flown = fly(section).trajectories
    write_states(tmp_path / "states.h5", by_number, flown)
    with h5py.File(tmp_path / "states.h5") as file:
        group: Any = file["trajectory_2"]
        np.testing.assert_array_equal(group["thrust_n"][:], flown[1].flight.thrust_n)
        assert group["trs_from_cam"].shape == (len(by_number[2]), 7)
        assert group["velocity_m_per_s"].attrs["units"] == "m/s"
    with pytest.raises(DatasetError, match="exists"):
        write_poses(tmp_path / "poses.csv", by_number)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("poses.txt", "must end in .csv for poses, or in .h5"),
        ("there.csv", "exists already, nothing is overwritten"),
        ("no/poses.csv", "there is no folder"),
    ],
)
def test_file_that_cannot_be_is_refused_before_anything_is_computed(
    tmp_path: Path, name: str, message: str
) -> None:
    (tmp_path / "there.csv").touch()
    with pytest.raises(ConfigError, match=message):
        check_out(tmp_path / name)
