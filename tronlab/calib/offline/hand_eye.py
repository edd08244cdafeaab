"""Recorded hand-eye data of several kinds, told apart by the files given."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from scipy.spatial.transform import RigidTransform

from tronlab.calib.hand_eye.streams import PoseStream, pair_streams
from tronlab.calib.inputs import PosePairInput, PosePairsInput, Setup, StationsInput, numbers_of
from tronlab.calib.offline.cameras import read_camera
from tronlab.calib.offline.files import hashes, images_in, read_text, written_utc
from tronlab.calib.offline.stations import stations_of_images
from tronlab.calib.offline.tables import (
    read_matrix_pairs,
    read_named_poses,
    read_pose_vector,
    read_streams,
)
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel

UNDERSTOOD = """\
  FOLDER with images and poses.csv (image,x,y,z,qx,qy,qz,qw: T-MAC in tracker, or hand in base)
  FOLDER of ViSP: images *-N.png, *_rPe_N.yaml, a camera .xml
  PAIRS.json of MoveIt: list of [hand in base, board in camera], 4 x 4 matrices
  TMAC.csv CAMERA.csv: two streams, rows of t,x,y,z,qx,qy,qz,qw; or both in one .zip"""
_STREAM_SUFFIXES = frozenset({".csv", ".zip"})
_POSE_TABLE = "poses.csv"
_VISP_POSE = re.compile(r"rPe_(\d+)\.ya?ml$")
_LAST_NUMBER = re.compile(r"(\d+)(?!.*\d)")
_VISP_BOARD = re.compile(
    r"(?P<columns>\d+)\s*x\s*(?P<rows>\d+).*square size:\s*(?P<square_m>[\d.]+)\s*m\b", re.DOTALL
)


def read_hand_eye(
    paths: Sequence[Path],
    *,
    pattern: PatternSpec | None,
    camera: CameraModel | None,
    setup: Setup = "eye_in_hand",
) -> StationsInput | PosePairsInput:
    """Read what somebody recorded for a hand-eye calibration.

    Args:
        paths: One folder or file, or two streams: first the T-MAC's, then the camera's, unless a
            name with "cam" says otherwise.
        pattern: What is printed on the board; only images need it.
        camera: The intrinsics if they are known; they are taken as they are. If None and the
            folder has none either, they are solved with the hand-eye transform.
        setup: ``eye_to_hand`` if the board is on the hand and the camera stands still: then the
            poses are inverted, and the result is base_from_cam.

    Raises:
        CalibrationError: A file cannot be read or understood; the message says which row, or which
            kinds of files are understood.
    """
    for path in paths:
        if not path.exists():
            raise CalibrationError(f"{path}: no such file or folder")
    suffixes = {path.suffix.lower() for path in paths if path.is_file()}
    if len(paths) == 1 and paths[0].is_dir():
        return _read_folder(paths[0], pattern, camera, setup)
    if len(paths) == 1 and suffixes == {".json"}:
        return _read_pairs(paths[0], setup)
    if suffixes and suffixes <= _STREAM_SUFFIXES and len(suffixes) == 1:
        return _read_streams(paths, setup)
    raise _not_understood(paths)


def _read_pairs(path: Path, setup: Setup) -> PosePairsInput:
    pairs = read_matrix_pairs(path)
    return _pose_pairs(
        [hand for hand, _ in pairs], [board for _, board in pairs], setup, files=[path], notes=()
    )


def _read_streams(paths: Sequence[Path], setup: Setup) -> PosePairsInput:
    streams = [stream for path in paths for stream in read_streams(path)]
    if len(streams) != 2:
        names = ", ".join(stream.name for stream in streams)
        raise CalibrationError(
            f"{', '.join(map(str, paths))}: {len(streams)} streams of poses ({names}), expected"
            " two: the T-MAC's and the camera's"
        )
    hand, cam = _hand_and_camera(streams)
    paired = pair_streams(hand, cam)
    return _pose_pairs(
        paired.pairs.trk_from_tmac,
        paired.pairs.cam_from_board,
        setup,
        files=paths,
        notes=paired.notes,
    )


def _hand_and_camera(streams: Sequence[PoseStream]) -> tuple[PoseStream, PoseStream]:
    first, second = streams
    is_cam = ["cam" in stream.name.lower() for stream in streams]
    return (second, first) if is_cam == [True, False] else (first, second)


def _pose_pairs(
    hands: Iterable[RigidTransform],
    boards: Iterable[RigidTransform],
    setup: Setup,
    *,
    files: Sequence[Path],
    notes: Sequence[str],
) -> PosePairsInput:
    return PosePairsInput(
        measured_utc=written_utc(files),
        pairs=tuple(
            PosePairInput.model_validate(
                {
                    "trk_from_tmac": numbers_of(_as_seen(hand, setup)),
                    "cam_from_board": numbers_of(board),
                }
            )
            for hand, board in zip(hands, boards, strict=True)
        ),
        setup=setup,
        files_sha256=hashes(files),
        notes=tuple(notes),
    )


def _as_seen(hand: RigidTransform, setup: Setup) -> RigidTransform:
    return hand.inv() if setup == "eye_to_hand" else hand


def _read_folder(
    folder: Path, pattern: PatternSpec | None, camera: CameraModel | None, setup: Setup
) -> StationsInput | PosePairsInput:
    if (folder / _POSE_TABLE).is_file():
        named = read_named_poses(folder / _POSE_TABLE)
        hands = {folder / name: pose for name, pose in named.items()}
    else:
        hands = _visp_poses(folder)
        pattern = pattern or _visp_pattern(folder)
    if not hands:
        raise _not_understood([folder])
    if pattern is None:
        raise CalibrationError(
            f"{folder}: what is printed on the board is not known; say its kind, columns, rows and"
            " square_m"
        )
    seen = {image: _as_seen(hand, setup) for image, hand in hands.items()}
    return stations_of_images(seen, pattern, camera=camera or _camera_in(folder), setup=setup)


def _visp_poses(folder: Path) -> Mapping[Path, RigidTransform]:
    """Give the poses of the hand by image; the last number of both names is the same."""
    files = {
        int(match[1]): path for path in folder.iterdir() if (match := _VISP_POSE.search(path.name))
    }
    if not files:
        return {}
    images = {
        int(match[1]): path
        for path in images_in([folder])
        if (match := _LAST_NUMBER.search(path.stem))
    }
    if missing := sorted(set(files) - set(images)):
        raise CalibrationError(f"{folder}: no image with the number {missing[0]}, as a pose has it")
    return {images[number]: read_pose_vector(path) for number, path in sorted(files.items())}


def _visp_pattern(folder: Path) -> PatternSpec | None:
    """Read what the text beside the images says of the board, in corners where we count squares."""
    for path in sorted(folder.glob("*chessboard*.txt")):
        if match := _VISP_BOARD.search(read_text(path)):
            return PatternSpec(
                kind="chessboard",
                columns=int(match["columns"]) + 1,
                rows=int(match["rows"]) + 1,
                square_m=float(match["square_m"]),
            )
    return None


def _camera_in(folder: Path) -> CameraModel | None:
    cameras = sorted(folder.glob("*camera*.xml"))
    return read_camera(cameras[0]) if cameras else None


def _not_understood(paths: Sequence[Path]) -> CalibrationError:
    return CalibrationError(
        f"{', '.join(map(str, paths))}: not understood; hand-eye data may be\n{UNDERSTOOD}"
    )
