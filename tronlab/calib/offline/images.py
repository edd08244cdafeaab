"""Views of a board from image files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tronlab.calib.camera.board import detect_board
from tronlab.calib.inputs import CameraValues, IntrinsicsInput, ViewInput
from tronlab.calib.offline.files import images_in, read_bytes, sha256, written_utc
from tronlab.devices.laboratory import PatternSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel

MIN_CORNERS = 12
"""Fewer are a part of the board that says little, or something else."""


@dataclass(frozen=True, slots=True)
class ImageViews:
    """What was found in several images of one camera."""

    size_px: tuple[int, int]
    """Width and height, the same of all."""
    views: dict[Path, ViewInput]
    """By file, those with a board only."""
    skipped: tuple[str, ...]
    """The others, one line each."""


def read_intrinsics(
    paths: Sequence[Path], *, pattern: PatternSpec, nominal_focal_px: float | None = None
) -> IntrinsicsInput:
    """Read images of a board.

    Args:
        paths: Images, or folders of them.
        pattern: What is printed on the board.
        nominal_focal_px: Where the focal length starts; by default the image's longer side, as a
            lens of 53 degrees has it.

    Raises:
        CalibrationError: A file cannot be read, the images differ in size, no image shows the
            board, or one shows another board (mirrored, another layout).
    """
    images = images_in(paths)
    found = read_views(images, pattern)
    return IntrinsicsInput(
        measured_utc=written_utc(images),
        pattern=pattern,
        nominal=CameraValues.of(nominal_camera(found.size_px, nominal_focal_px)),
        views=tuple(found.views.values()),
        skipped=found.skipped,
    )


def read_views(images: Sequence[Path], pattern: PatternSpec) -> ImageViews:
    """Find the board in every image.

    Raises:
        CalibrationError: As ``read_intrinsics``.
    """
    views: dict[Path, ViewInput] = {}
    skipped: list[str] = []
    sizes: dict[tuple[int, int], Path] = {}
    for path in images:
        image = _read_grey(path)
        sizes.setdefault((image.shape[1], image.shape[0]), path)
        try:
            view = detect_board(image, pattern)
        except CalibrationError as error:
            raise CalibrationError(f"{path}: {error}") from error
        if len(view) < MIN_CORNERS:
            n = f"{len(view)} corners of the board" if len(view) else "no board"
            skipped.append(f"{path.name}: {n} found")
        else:
            views[path] = ViewInput.of(view, image=path.name, image_sha256=sha256(path))
    if len(sizes) > 1:
        found = ", ".join(f"{path.name} {w} x {h}" for (w, h), path in sizes.items())
        raise CalibrationError(f"images of different sizes: {found}; one camera has one size")
    if not views:
        raise CalibrationError(
            f"no board of {pattern.columns} x {pattern.rows} squares ({pattern.kind}) found in any"
            f" of {len(images)} images, as {images[0]}; check kind, columns (squares, not corners),"
            " rows and dictionary"
        )
    return ImageViews(next(iter(sizes)), views, tuple(skipped))


def nominal_camera(size_px: tuple[int, int], focal_px: float | None = None) -> CameraModel:
    """Give a camera to start from: centred, square pixels, no distortion."""
    width, height = size_px
    focal = float(max(size_px)) if focal_px is None else focal_px
    return CameraModel(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _read_grey(path: Path) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    content = np.frombuffer(read_bytes(path), np.uint8)
    image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    # OpenCV's stubs do not say that it gives None for what is no image.
    if image is None:  # pyright: ignore[reportUnnecessaryComparison]
        raise CalibrationError(f"{path}: cannot be read as an image")
    return np.asarray(image, np.uint8)
