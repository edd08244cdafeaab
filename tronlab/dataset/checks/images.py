"""Can the images be used, and do the masks fit them?"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tronlab.dataset import schema
from tronlab.dataset.checks.columns import imported
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ReferenceView
from tronlab.errors import IntegrityError

_FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
_USABLE_PART = 0.01
"""Least part of the mask whose pixels must be neither black nor saturated."""
_FRACTION_TOLERANCE = 1e-9

OnShot = Callable[[int, int], None]
"""Told how many shots are done, of how many."""


def images(dataset: Dataset, on_shot: OnShot) -> Iterator[str]:
    """Find images and masks that are damaged or of no use; one shot is in memory at a time."""
    fractions = dataset.rows(f"{schema.TRUTH}/usable_fraction")
    is_imported = imported(dataset)
    for i, shot_id in enumerate(dataset.shot_ids):
        try:
            image, mask = dataset.image(i), dataset.mask(i)
            pixel_format = dataset.pixel_format(i)
        except IntegrityError as error:
            yield sentence(dataset, error)
        else:
            for finding in (*_image(image, mask, pixel_format), *_mask(mask, fractions[i])):
                yield f"shot {shot_id}: {finding}"
            # Others may mask as they like; ours is the outline of one rectangle.
            if not is_imported[i] and (n := _n_parts(mask)) > 1:
                yield f"shot {shot_id}: the mask falls into {n} parts, expected one outline"
        on_shot(i + 1, dataset.n_shots)


def references(dataset: Dataset) -> Iterator[str]:
    """Find reference views that are damaged or show nothing."""
    ids: list[int] = []
    for i in range(dataset.n_references):
        try:
            view = dataset.reference(i)
        except IntegrityError as error:
            yield sentence(dataset, error)
            continue
        ids.append(view.view_id)
        for finding in _view(view, dataset.camera.shape):
            yield f"reference view {view.view_id}: {finding}"
    if len(set(ids)) != len(ids):
        yield "reference views: an id is there twice"


def sentence(dataset: Dataset, error: IntegrityError) -> str:
    """Say what an error says, without the name of the dataset."""
    return str(error).removeprefix(f"{dataset.path}: ")


def _image(
    image: NDArray[np.uint8] | NDArray[np.uint16], mask: NDArray[np.bool_], pixel_format: str
) -> Iterator[str]:
    full_scale = _FULL_SCALE.get(pixel_format, int(np.iinfo(image.dtype).max))
    if image.max() > full_scale:
        yield f"a grey value is {image.max()}, but {pixel_format} ends at {full_scale}"
    seen = image[mask] if mask.any() else image
    if np.mean(seen > 0) < _USABLE_PART:
        yield "the image is black"
    if np.mean(seen < full_scale) < _USABLE_PART:
        yield "the image is saturated"


def _mask(mask: NDArray[np.bool_], usable_fraction: float) -> Iterator[str]:
    if not mask.any():
        yield "the mask is empty"
    if not abs(mask.mean() - usable_fraction) <= _FRACTION_TOLERANCE:
        yield f"usable fraction is {usable_fraction:.6g}, the mask's is {mask.mean():.6g}"


def _n_parts(mask: NDArray[np.bool_]) -> int:
    """Count the connected parts of a mask; pixels that touch at a corner are connected."""
    labels: NDArray[np.int32] = np.empty(mask.shape, np.int32)
    ndimage.label(mask, structure=np.ones((3, 3), dtype=np.bool_), output=labels)
    return int(labels.max())


def _view(view: ReferenceView, shape: tuple[int, int]) -> Iterator[str]:
    arrays: dict[str, NDArray[Any]] = {
        "image": view.image,
        "depth_m": view.depth_m,
        "mask": view.mask,
    }
    for name, array in arrays.items():
        if array.shape != shape:
            yield f"{name} has shape {array.shape}, the camera {shape}"
    if not np.any(view.depth_m > 0):
        yield "no terrain is seen"
    elif np.nanmin(view.depth_m) <= 0:
        yield "a depth is not positive"
