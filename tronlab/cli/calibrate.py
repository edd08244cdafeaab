"""The commands ``tronlab calibrate``: measured at a rig, or solved from recorded files."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.errors import ConfigError

if TYPE_CHECKING:
    from tronlab.devices.laboratory import PatternSpec

EXIT_DIFFERENT = 1
OFFLINE_RIG = "offline"

calibrate = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Calibrate a rig, whole or part by part; solve recorded files; compare records.",
)


class PatternKind(StrEnum):
    """What is printed on a board."""

    CHARUCO = "charuco"
    CHARUCO_LEGACY = "charuco_legacy"
    CHESSBOARD = "chessboard"


_Rig = Annotated[Path, typer.Option("--rig", metavar="RIG.yaml", help="Rig file.")]
_RigOrFiles = Annotated[
    Path | None, typer.Option("--rig", metavar="RIG.yaml", help="Rig file: measure at the rig.")
]
_Files = Annotated[
    list[Path] | None,
    typer.Option("--from", metavar="PATH", help="Recorded files or folders instead of a rig."),
]
_MoreFiles = Annotated[
    list[Path] | None, typer.Argument(metavar="[PATH]...", help="Further paths after --from.")
]
_Record = Annotated[
    Path | None,
    typer.Option(
        metavar="RECORD.json",
        help="File of the calibration record.  [default: calibration/records/RIG-NAME.json]",
    ),
]
_Seed = Annotated[
    int,
    typer.Option(min=0, max=2**32 - 1, help="Seed of the measurement noise of simulated devices."),
]
_Yes = Annotated[bool, typer.Option("--yes", help="Ask nothing: take what the wizard proposes.")]
_RigName = Annotated[str, typer.Option(help="With --from: whose the record is.")]
_Kind = Annotated[
    PatternKind | None, typer.Option("--pattern", help="With --from: what is on the board.")
]
_Columns = Annotated[
    int | None, typer.Option(min=3, help="With --from: number of squares along x of the board.")
]
_Rows = Annotated[
    int | None, typer.Option(min=3, help="With --from: number of squares along y of the board.")
]
_Square = Annotated[float | None, typer.Option(help="With --from: side of a square, metres.")]
_Marker = Annotated[
    float | None, typer.Option(help="With --from: side of a marker, metres; ChArUco only.")
]
_Dictionary = Annotated[str, typer.Option(help="With --from: the markers' dictionary.")]


@calibrate.command("all")
def everything(
    *,
    rig: _Rig,
    record: _Record = None,
    seed: _Seed = 0,
    yes: _Yes = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing record; the old one is kept.")
    ] = False,
) -> None:
    """Measure everything: model frame, lamp, robot, camera and hand-eye transform."""
    from tronlab.cli.calibration_session import measure_all

    measure_all(rig, record, yes=yes, seed=seed, force=force)


@calibrate.command()
def frame(*, rig: _Rig, record: _Record = None, seed: _Seed = 0, yes: _Yes = False) -> None:
    """Measure the model's reflectors: all there is to do after the tracker was moved."""
    from tronlab.cli.calibration_session import measure_part

    measure_part("frame", rig, record, yes=yes, seed=seed)


@calibrate.command()
def lamp(*, rig: _Rig, record: _Record = None, seed: _Seed = 0, yes: _Yes = False) -> None:
    """Measure the reflector on the lamp, and the model's reflectors with it."""
    from tronlab.cli.calibration_session import measure_part

    measure_part("lamp", rig, record, yes=yes, seed=seed)


@calibrate.command()
def robot(*, rig: _Rig, record: _Record = None, seed: _Seed = 0, yes: _Yes = False) -> None:
    """Measure where the T-MAC is at many places of arm and rail, so that poses are met."""
    from tronlab.cli.calibration_session import measure_part

    measure_part("robot", rig, record, yes=yes, seed=seed)


@calibrate.command()
def intrinsics(
    paths: _MoreFiles = None,
    *,
    rig: _RigOrFiles = None,
    files: _Files = None,
    record: _Record = None,
    seed: _Seed = 0,
    yes: _Yes = False,
    rig_name: _RigName = OFFLINE_RIG,
    kind: _Kind = None,
    columns: _Columns = None,
    rows: _Rows = None,
    square_m: _Square = None,
    marker_m: _Marker = None,
    dictionary: _Dictionary = "DICT_5X5_250",
    focal_px: Annotated[
        float | None, typer.Option(min=1.0, help="With --from: focal length to start from, pixels.")
    ] = None,
) -> None:
    """Calibrate the camera from images of a board: taken at a rig, or files."""
    from tronlab.cli.calibration_session import measure_part, solve_files

    recorded = _recorded(rig, files, paths)
    if rig is not None:
        measure_part("intrinsics", rig, record, yes=yes, seed=seed)
        return
    pattern = _pattern(
        kind, dictionary, columns=columns, rows=rows, square_m=square_m, marker_m=marker_m
    )
    if pattern is None:
        raise ConfigError(
            "--from needs to know what is on the board: --pattern, --columns, --rows and --square-m"
        )
    from tronlab.calib.offline import read_intrinsics
    from tronlab.cli.calibration_files import record_path

    read = read_intrinsics(recorded, pattern=pattern, nominal_focal_px=focal_px)
    solve_files(record_path(record, rig_name), rig_name, intrinsics=read)


@calibrate.command("hand-eye")
def hand_eye(
    paths: _MoreFiles = None,
    *,
    rig: _RigOrFiles = None,
    files: _Files = None,
    record: _Record = None,
    seed: _Seed = 0,
    yes: _Yes = False,
    rig_name: _RigName = OFFLINE_RIG,
    kind: _Kind = None,
    columns: _Columns = None,
    rows: _Rows = None,
    square_m: _Square = None,
    marker_m: _Marker = None,
    dictionary: _Dictionary = "DICT_5X5_250",
    camera: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With --from: the camera, if it is known."),
    ] = None,
    eye_to_hand: Annotated[
        bool, typer.Option("--eye-to-hand", help="With --from: the board is on the hand.")
    ] = False,
) -> None:
    """Find where the camera sits on the T-MAC, and calibrate the camera with it.

    At a rig, or from files: poses and images, pose pairs, or two time-stamped streams of poses.
    """
    from tronlab.cli.calibration_session import measure_part, solve_files

    recorded = _recorded(rig, files, paths)
    if rig is not None:
        measure_part("hand_eye", rig, record, yes=yes, seed=seed)
        return
    from tronlab.calib.offline import read_camera, read_hand_eye
    from tronlab.cli.calibration_files import record_path

    read = read_hand_eye(
        recorded,
        pattern=_pattern(
            kind, dictionary, columns=columns, rows=rows, square_m=square_m, marker_m=marker_m
        ),
        camera=None if camera is None else read_camera(camera),
        setup="eye_to_hand" if eye_to_hand else "eye_in_hand",
    )
    solve_files(record_path(record, rig_name), rig_name, hand_eye=read)


@calibrate.command()
def photometry(
    *,
    dataset: Annotated[
        Path,
        typer.Option("--from", metavar="DATASET", help="Recorded dataset, or its folder."),
    ],
    record: Annotated[
        Path, typer.Option(metavar="RECORD.json", help="Calibration record to put it into.")
    ],
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig", metavar="RIG.yaml", help="Rig file, to find the terrain if it is a file."
        ),
    ] = None,
) -> None:
    """Find how the paint of the model reflects light, from images of a recorded dataset."""
    from tronlab.cli.calibration_photometry import calibrate_photometry

    calibrate_photometry(dataset, record, rig)


@calibrate.command()
def rerun(
    record: Annotated[Path, typer.Argument(metavar="RECORD.json", help="Calibration record.")],
    out: Annotated[
        Path | None, typer.Option(metavar="NEW.json", help="Write the record solved again.")
    ] = None,
) -> None:
    """Solve a record's readings again; the exit code is 1 if the answer is not the same."""
    from tronlab.cli.calibration_rerun import rerun_record

    if not rerun_record(record, out):
        raise typer.Exit(EXIT_DIFFERENT)


@calibrate.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="RECORD.json", help="The earlier record.")],
    second: Annotated[Path, typer.Argument(metavar="RECORD.json", help="The later record.")],
) -> None:
    """Say what moved between two records, in units and in sigmas."""
    from tronlab.calib.compare import compare_records
    from tronlab.calib.record import CalibrationRecord

    comparison = compare_records(CalibrationRecord.load(first), CalibrationRecord.load(second))
    typer.echo(comparison.table())


def _recorded(rig: Path | None, files: list[Path] | None, more: list[Path] | None) -> list[Path]:
    """Give the recorded files; either they or a rig must be named."""
    if files and rig is not None:
        raise ConfigError("--rig measures, --from reads files: name one of them")
    if not files and more:
        raise ConfigError(f"'{more[0]}': put --from before the recorded files")
    if not files and rig is None:
        raise ConfigError("name a rig file to measure: --rig RIG.yaml, or recorded files: --from")
    return [*(files or ()), *(more or ())]


def _pattern(
    kind: PatternKind | None, dictionary: str, **sizes: float | None
) -> "PatternSpec | None":
    """Give what is on the board; None if nothing was said of it."""
    from tronlab.devices.laboratory import PatternSpec
    from tronlab.yaml_models import parse_mapping

    given: dict[str, float | str] = {k: v for k, v in sizes.items() if v is not None}
    if kind is not None:
        given["kind"] = kind.value
    if not given:
        return None
    return parse_mapping({**given, "dictionary": dictionary}, PatternSpec, key="board")
