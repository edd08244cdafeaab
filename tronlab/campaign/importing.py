"""Datasets made from images and poses that others recorded, so that they can be scored."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.camera_file import CameraFile, camera_beside, read_camera_file
from tronlab.campaign.config import DatabaseConfig
from tronlab.campaign.live import Live, SilentLive
from tronlab.campaign.provenance import software_versions
from tronlab.campaign.reference import render_references
from tronlab.campaign.rig import Rig, load_rig
from tronlab.dataset.exchange.folder_import import read_folder
from tronlab.dataset.exchange.foreign import ForeignSet, ForeignShot, shot_record
from tronlab.dataset.exchange.staging import staged_folder
from tronlab.dataset.exchange.text_files import read_text
from tronlab.dataset.exchange.tum_import import TUM_MAX_DIFFERENCE_S, read_tum
from tronlab.dataset.journal import Journal
from tronlab.dataset.location import DATASET_NAME
from tronlab.dataset.records import Provenance, ReferenceView, Session, ShotRecord
from tronlab.dataset.skeleton import utc_now
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.planning.shots import database_indices, range_los_m
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.mask import model_mask
from tronlab.render.renderer import lamp_as_designed
from tronlab.render.settings import RenderedImages
from tronlab.terrain.heightmap import HeightMap

_UNKNOWN_RIG = "unknown"


@dataclass(frozen=True)
class _Model:
    """The terrain model that the images show, as a rig file has it."""

    rig: Rig
    heightmap: HeightMap

    @cached_property
    def renderer(self) -> HeightfieldRenderer:
        """Get who finds ranges and renders views."""
        return HeightfieldRenderer(self.heightmap)


def import_folder(
    csv_path: Path,
    out_dir: Path,
    *,
    name: str | None = None,
    camera_path: Path | None = None,
    rig_path: Path | None = None,
    live: Live | None = None,
) -> Path:
    """Make a dataset from a table of images and poses.

    Args:
        csv_path: The table; ``docs/reference/exchange.md`` has its columns.
        out_dir: The folder to make; the dataset is ``dataset.h5`` in it.
        name: What the dataset says its campaign is; by default the name of ``out_dir``.
        camera_path: Intrinsics: a camera file, or a calibration record, whose lamp then lights the
            reference views; by default ``camera.json`` beside the table.
        rig_path: Rig whose terrain the images show: gives ranges, masks and reference views that
            the set does not bring along.
        live: Shows how far it is.

    Returns:
        Path of the dataset.

    Raises:
        DatasetError: The set cannot be read, says something that cannot be, or lacks the ranges;
            or ``out_dir`` exists or cannot be written. Nothing is left of it then.
        CalibrationError: The camera file cannot be read.
        ConfigError: The rig file cannot be read.
    """
    live = live or SilentLive()
    foreign = read_folder(csv_path)
    return _import(
        foreign,
        out_dir,
        name=name,
        sources=(csv_path,),
        camera=read_camera_file(camera_path or camera_beside(csv_path)),
        model=_read_model(rig_path, live),
        live=live,
    )


def import_tum(
    images_path: Path,
    trajectory_path: Path,
    camera_path: Path,
    out_dir: Path,
    *,
    rig_path: Path,
    name: str | None = None,
    max_difference_s: float = TUM_MAX_DIFFERENCE_S,
    offset_s: float = 0.0,
    live: Live | None = None,
) -> Path:
    """Make a dataset from a list of images and a trajectory as of the TUM RGB-D benchmark.

    An image takes the pose that is nearest in time; nothing is interpolated.

    Args:
        images_path: Rows of ``timestamp filename``.
        trajectory_path: Rows of ``timestamp tx ty tz qx qy qz qw``: the camera in F_TRS.
        camera_path: As for ``import_folder``.
        out_dir: Likewise.
        rig_path: Likewise; needed, for the format has no ranges.
        name: Likewise.
        max_difference_s: Images without a pose so near in time are left out.
        offset_s: Added to the times of the trajectory.
        live: Shows how far it is.

    Returns:
        Path of the dataset.

    Raises:
        DatasetError: As ``import_folder``, or no image has a pose.
        CalibrationError: The camera file cannot be read.
        ConfigError: The rig file cannot be read.
    """
    live = live or SilentLive()
    foreign = read_tum(
        images_path, trajectory_path, max_difference_s=max_difference_s, offset_s=offset_s
    )
    return _import(
        foreign,
        out_dir,
        name=name,
        sources=(images_path, trajectory_path),
        camera=read_camera_file(camera_path),
        model=_read_model(rig_path, live),
        live=live,
    )


def _import(
    foreign: ForeignSet,
    out_dir: Path,
    *,
    name: str | None,
    sources: Sequence[Path],
    camera: CameraFile,
    model: _Model | None,
    live: Live,
) -> Path:
    n_shots = len(foreign.shots)
    for note in foreign.notes:
        live.announce(note)
    provenance = _provenance(
        name or out_dir.name, sources=sources, n_shots=n_shots, camera=camera, model=model
    )
    with staged_folder(out_dir) as folder:
        path = folder / DATASET_NAME
        ranges_m = [_range_los_m(shot, model) for shot in foreign.shots]
        views = _views(foreign, camera, model, live)
        session = _session(provenance, sources=sources, camera=camera, model=model)
        with DatasetWriter(path, provenance, session=session) as writer:
            if views:
                writer.add_references(views)
            for i, (shot, range_m) in enumerate(zip(foreign.shots, ranges_m, strict=True)):
                mask = _mask(shot, camera.model, model)
                record = shot_record(shot, camera.model, mask=mask, range_los_m=range_m)
                _commit(writer, record, shot.where)
                live.advance("shots", n_done=i + 1, n_all=n_shots)
            writer.finish("complete")
        _write_journal(path, foreign, sources)
    return out_dir / DATASET_NAME


def _commit(writer: DatasetWriter, record: ShotRecord, where: str) -> None:
    try:
        writer.commit(record)
    except DatasetError as error:
        # The file has its name only when all is well: nobody knows it by that of now.
        raise DatasetError(f"{where}: {str(error).removeprefix(f'{writer.path}: ')}") from error


def _read_model(rig_path: Path | None, live: Live) -> _Model | None:
    if rig_path is None:
        return None
    rig = load_rig(rig_path)
    return _Model(rig, rig.load_heightmap(live.announce))


def _range_los_m(shot: ForeignShot, model: _Model | None) -> float:
    """Give the distance that errors are judged by.

    Raises:
        DatasetError: The set does not say, and there is no terrain, or it is missed.
    """
    if np.isfinite(shot.range_los_m):
        return shot.range_los_m
    if model is None:
        raise DatasetError(
            f"{shot.where}: shot {shot.shot_id}: no range_los_m, and errors are per cent of it;"
            " fill that column, or name the rig whose terrain the images show: --rig RIG.yaml"
        )
    range_m = range_los_m(
        model.renderer, shot.trs_from_cam, ground_trs_m=model.heightmap.mean_height_trs_m
    )
    if not np.isfinite(range_m):
        raise DatasetError(
            f"{shot.where}: shot {shot.shot_id}: its optical axis does not meet the ground of"
            f" {model.rig.path}; are the poses in that terrain's frame (F_TRS), camera z forward?"
        )
    return range_m


def _mask(shot: ForeignShot, camera: CameraModel, model: _Model | None) -> NDArray[np.bool_]:
    """Give the set's own mask, else the terrain's outline, else the whole image."""
    mask = shot.mask(camera)
    if mask is not None:
        return mask
    if model is None:
        return np.ones(camera.shape, dtype=np.bool_)
    return model_mask(model.heightmap, camera, shot.trs_from_cam)


def _views(
    foreign: ForeignSet, camera: CameraFile, model: _Model | None, live: Live
) -> tuple[ReferenceView, ...]:
    """Give the set's own reference views, else render some, else none."""
    if foreign.views:
        return tuple(view.read(camera.model) for view in foreign.views)
    if model is None:
        live.announce(
            "no reference views: cores that need them cannot be scored; to render some, name the"
            " rig whose terrain the images show: --rig RIG.yaml"
        )
        return ()
    return render_references(
        _reference_poses(foreign, live),
        heightmap=model.heightmap,
        renderer=model.renderer,
        camera=camera.model,
        lamp=lamp_as_designed(
            model.rig.config.laboratory.lamp, _p_lamp_trs_m(camera, model.rig, live)
        ),
        config=RenderedImages(rays_per_pixel=4),
        on_view=lambda n_done, n_all: live.advance("reference views", n_done=n_done, n_all=n_all),
    )


def _reference_poses(foreign: ForeignSet, live: Live) -> list[RigidTransform]:
    n_shots = len(foreign.shots)
    n_views = min(DatabaseConfig().n_views or n_shots, n_shots)
    chosen = [foreign.shots[i] for i in database_indices(n_shots, n_views=n_views)]
    if any(shot.planned_trs_from_cam is None for shot in chosen):
        live.announce(
            "the set has no nominal poses: reference views are rendered at true ones, which makes"
            " the shots taken there easy"
        )
    return [shot.trs_from_cam_nominal for shot in chosen]


def _p_lamp_trs_m(camera: CameraFile, rig: Rig, live: Live) -> FloatArray:
    if camera.record is not None and camera.record.results.lamp is not None:
        return camera.record.p_lamp_trs_m
    live.announce(f"reference views are lit from where {rig.path} has the lamp by design")
    return np.array(rig.config.laboratory.lamp.p_trs_m, dtype=np.float64)


def _provenance(
    name: str, *, sources: Sequence[Path], n_shots: int, camera: CameraFile, model: _Model | None
) -> Provenance:
    return Provenance(
        campaign_name=name,
        campaign_yaml="",
        rig_name=_UNKNOWN_RIG if model is None else model.rig.name,
        rig_yaml="" if model is None else model.rig.whole_text,
        calibration_json=camera.record_text,
        seed=0,
        software=software_versions(),
        devices={},
        plan_sha256=sha256("".join(map(read_text, sources)).encode()).hexdigest(),
        n_shots_planned=n_shots,
        camera=camera.model,
    )


def _session(
    provenance: Provenance, *, sources: Sequence[Path], camera: CameraFile, model: _Model | None
) -> Session:
    return Session(
        number=1,
        kind="import",
        start_utc=utc_now(),
        campaign_path=str(sources[0].absolute()),
        rig_path="" if model is None else str(model.rig.path.absolute()),
        calibration_path=str(camera.path.absolute()),
        campaign_yaml=provenance.campaign_yaml,
        rig_yaml=provenance.rig_yaml,
        calibration_json=provenance.calibration_json,
        plan_sha256=provenance.plan_sha256,
        seed=provenance.seed,
        software=provenance.software,
        devices=provenance.devices,
        host=socket.gethostname(),
        pid=os.getpid(),
    )


def _write_journal(path: Path, foreign: ForeignSet, sources: Sequence[Path]) -> None:
    journal = Journal(path)
    journal.write("session", f"imported from {', '.join(map(str, sources))}", session=1)
    for note in foreign.notes:
        journal.write("note", note)
