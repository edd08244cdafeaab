"""All hand-eye closed forms of OpenCV 4 on poses from standard input; ``hand_eye.py`` runs this.

In: a list of sets {"trk_from_tmac": [4x4], "cam_from_board": [4x4]}. Out: of each set the 4x4
``tmac_from_cam`` by name of the method, null where a method finds none.
"""

import json
import sys

import cv2
import numpy as np

HAND_EYE = {
    "Tsai-Lenz": cv2.CALIB_HAND_EYE_TSAI,
    "Park-Martin": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
ROBOT_WORLD = {
    "Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    "Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
}


def main() -> None:
    """Solve every set by every method."""
    json.dump([solve(poses) for poses in json.load(sys.stdin)], sys.stdout)


def solve(poses: dict) -> dict:
    """Solve one set by every method."""
    trk_from_tmac, cam_from_board = (
        np.array(poses[name]) for name in ("trk_from_tmac", "cam_from_board")
    )
    return {
        **{name: hand_eye(trk_from_tmac, cam_from_board, code) for name, code in HAND_EYE.items()},
        **{
            name: robot_world(trk_from_tmac, cam_from_board, code)
            for name, code in ROBOT_WORLD.items()
        },
    }


def hand_eye(trk_from_tmac: np.ndarray, cam_from_board: np.ndarray, code: int) -> list | None:
    """OpenCV's gripper2base is trk_from_tmac, its target2cam is cam_from_board."""
    return matrix(*cv2.calibrateHandEye(*split(trk_from_tmac), *split(cam_from_board), method=code))


def robot_world(trk_from_tmac: np.ndarray, cam_from_board: np.ndarray, code: int) -> list | None:
    """OpenCV's world is the board, its base the tracker; it gives gripper2cam, cam_from_tmac."""
    tmac_from_trk = np.linalg.inv(trk_from_tmac)
    *_, rotation, translation = cv2.calibrateRobotWorldHandEye(
        *split(cam_from_board), *split(tmac_from_trk), method=code
    )
    return matrix(rotation.T, -rotation.T @ translation)


def split(poses: np.ndarray) -> tuple[list, list]:
    """Give rotations and translations."""
    return [pose[:3, :3] for pose in poses], [pose[:3, 3] for pose in poses]


def matrix(rotation: np.ndarray, translation: np.ndarray) -> list | None:
    """Give a pose as a list; None if it is no pose."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, np.ravel(translation)
    return pose.tolist() if np.isfinite(pose).all() else None


if __name__ == "__main__":
    main()
