"""Keys of results: a digest of everything that the answer of a core depends on.

That is the core, its settings and seed, what the camera took, the calibration and the prior. Ground
truth is not in it: when truth is recomputed, answers stay and only the table is made anew.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import astuple

import numpy as np

from tronlab.dataset import schema
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.dataset.opening import open_dataset
from tronlab.dataset.reader import Dataset
from tronlab.nav.core import PosePrior
from tronlab.nav.specs import CoreSpec
from tronlab.nav.stages import stage_key
from tronlab.score.rescoring.prior import PriorSettings


def frame_keys(dataset: Dataset) -> tuple[str, ...]:
    """Give what tells the image and mask of each shot from all others.

    The uuid of the dataset is left out: a copy with a recomputed truth has another.
    """
    columns = (
        dataset.shot_ids.tolist(),
        dataset.rows(f"{schema.CAMERA}/time_s").tolist(),
        dataset.rows(schema.IMAGE_CRC32).tolist(),
        dataset.rows(schema.MASK_CRC32).tolist(),
    )
    recording = dataset.start_time, str(dataset.image_dtype)
    return tuple(
        _digest(*recording, shot_id, repr(time_s), image_crc32, mask_crc32)
        for shot_id, time_s, image_crc32, mask_crc32 in zip(*columns, strict=True)
    )


def calibration_key(dataset: Dataset) -> str:
    """Give what tells the camera and the reference views from all others."""
    camera = repr(astuple(dataset.camera))
    if not dataset.n_references:
        return _digest(camera)
    file = Hdf5Reader(dataset.path, open_dataset(dataset.path))
    try:
        return _digest(camera, *file.read(schema.REFERENCES_CRC32).tolist())
    finally:
        file.close()


def core_key(spec: CoreSpec, identity: str) -> str:
    """Give what tells a core as it is, with its settings and seed, from all others.

    The name is left out: a core may be scored under several.
    """
    return stage_key(
        identity=identity,
        kind=spec.kind,
        target=spec.target,
        settings=dict(spec.settings),
        seed=spec.seed,
    )


def result_keys(
    core: str,
    calibration: str,
    frames: Sequence[str],
    *,
    prior: PriorSettings | None,
    priors: Sequence[PosePrior | None],
    is_chained: bool,
) -> tuple[str, ...]:
    """Give the key of the answer to each shot.

    Args:
        core: ``core_key``.
        calibration: ``calibration_key``.
        frames: ``frame_keys``, in the order the core sees them.
        prior: Settings of the prior.
        priors: What is offered with each shot, as far as it is known beforehand.
        is_chained: The answer to a shot depends on those before.
    """
    keys: list[str] = []
    settings = "" if prior is None else prior.model_dump_json()
    before = _digest("chain", settings) if is_chained else ""
    for frame, offered in zip(frames, priors, strict=True):
        keys.append(_digest(core, calibration, before, frame, _prior_key(offered)))
        before = keys[-1] if is_chained else ""
    return tuple(keys)


def _prior_key(prior: PosePrior | None) -> str:
    if prior is None:
        return ""
    numbers = [prior.trs_from_cam.as_matrix(), prior.covariance]
    return hashlib.blake2b(b"".join(map(np.ndarray.tobytes, numbers)), digest_size=20).hexdigest()


def _digest(*parts: object) -> str:
    digest = hashlib.blake2b(digest_size=20)
    for part in parts:
        text = str(part).encode()
        digest.update(len(text).to_bytes(8, "little") + text)
    return digest.hexdigest()
