"""Two streams of poses with their own clocks, made into pairs taken at the same moments.

The offset of the clocks follows from how fast both turn, which depends on no transform: first by
correlation, then as one more unknown of the hand-eye solution. The stream with more poses is
interpolated at the times of the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from tronlab.calib.hand_eye.closed_forms import check_motions, solve_closed_forms
from tronlab.calib.hand_eye.contradictions import check_agreement, is_one_inverted
from tronlab.calib.hand_eye.pose_fit import (
    PoseFit,
    PosePairs,
    fit_pose_pairs,
    mean_correlation,
    one_more_unknown,
    residuals,
)
from tronlab.calib.hand_eye.pose_pairs import best_start
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

MIN_POSES = 20
_GAP_INTERVALS = 5.0
"""A gap of more than so many usual intervals is not interpolated over."""
_MOST_STEPS = 10_000_000
"""Of a stream, in intervals of the faster one: a day at 100 Hz."""
_LEAST_CORRELATION = 0.5
"""Of the rates of turn; less is not one motion."""
_LEAST_OVERLAP = 0.3
"""Of the shorter stream."""
_RATE_INTERVALS = 3
"""Of the slower stream, over which a rate of turn is taken: fewer are all noise."""
_MAX_REFINEMENTS = 20
_CONVERGED_SIGMAS = 0.05


@dataclass(frozen=True, slots=True)
class PoseStream:
    """Poses with time stamps, as they were recorded."""

    name: str
    """What messages call it: its file."""
    time_s: FloatArray
    """Shape (n,)."""
    poses: RigidTransform
    """n poses."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, chosen: NDArray[np.bool_]) -> "PoseStream":
        return replace(self, time_s=self.time_s[chosen], poses=self.poses[chosen])

    @property
    def interval_s(self) -> float:
        """Get the usual time between two poses."""
        return float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True, slots=True)
class PairedStreams:
    """Two streams on one clock."""

    pairs: PosePairs
    offset_s: float
    """What must be added to the tracker's time stamps to have the camera's."""
    offset_sigma_s: float
    notes: tuple[str, ...]
    """What was found and left out, one line each."""


def pair_streams(tmac: PoseStream, cam: PoseStream) -> PairedStreams:
    """Pair two streams whose clocks differ by a constant.

    Args:
        tmac: trk_from_tmac.
        cam: cam_from_board, or board_from_cam: the turns tell which.

    Raises:
        CalibrationError: Too few poses, no motion in common, or no overlap.
        DegenerateGeometryError: The motion does not determine a hand-eye transform.
    """
    notes: list[str] = []
    tmac, cam = (_in_order(stream, notes) for stream in (tmac, cam))
    overlap = _overlap(tmac, cam, _offset_by_rates(tmac, cam))
    pairs = overlap.pairs_at(overlap.offset_s)
    check_motions(pairs.trk_from_tmac)
    if is_one_inverted(pairs.trk_from_tmac, pairs.cam_from_board):
        notes.append(f"{cam.name}: holds the camera in the board, as the turns show; inverted")
        cam = replace(cam, poses=cam.poses.inv())
        overlap = _overlap(tmac, cam, overlap.offset_s)
    pairs = overlap.pairs_at(overlap.offset_s)
    check_agreement(pairs.trk_from_tmac, pairs.cam_from_board)
    offset_s, sigma_s = _refine(overlap)
    overlap = _overlap(tmac, cam, offset_s)
    pairs = overlap.pairs_at(offset_s)
    notes += _overlap_notes(tmac, cam, offset_s)
    notes.append(f"clocks: tracker + ({1e3 * offset_s:.2f} +- {1e3 * sigma_s:.2f}) ms = camera")
    notes.append(f"{len(pairs)} pairs at the times of {overlap.slower.name}")
    return PairedStreams(pairs, offset_s, sigma_s, tuple(notes))


def _in_order(stream: PoseStream, notes: list[str]) -> PoseStream:
    """Leave out poses whose time stamp is not later than all before."""
    latest = np.maximum.accumulate(stream.time_s)
    is_repeated = np.zeros(len(stream), dtype=np.bool_)
    is_repeated[1:] = stream.time_s[1:] == latest[:-1]
    is_backward = stream.time_s < latest
    for what, is_wrong in (("repeated", is_repeated), ("backward", is_backward)):
        if is_wrong.any():
            rows = ", ".join(str(i + 1) for i in np.flatnonzero(is_wrong)[:5])
            more = ", ..." if is_wrong.sum() > 5 else ""
            notes.append(
                f"{stream.name}: {is_wrong.sum()} {what} time stamps left out (poses {rows}{more})"
            )
    kept = stream[~(is_repeated | is_backward)]
    if len(kept) < MIN_POSES:
        raise CalibrationError(
            f"{stream.name}: {len(kept)} poses in order of time, at least {MIN_POSES} needed"
        )
    return kept


def _offset_by_rates(tmac: PoseStream, cam: PoseStream) -> float:
    """Find the offset at which the rates of turn correlate best, to one interval."""
    step_s = min(tmac.interval_s, cam.interval_s)
    for stream in (tmac, cam):
        if (lasts_s := float(np.ptp(stream.time_s))) > _MOST_STEPS * step_s:
            raise CalibrationError(
                f"{stream.name}: lasts {lasts_s:.3g} s, while the faster stream has a pose every"
                f" {step_s:.3g} s; give all time stamps in seconds"
            )
    span_s = _RATE_INTERVALS * max(tmac.interval_s, cam.interval_s)
    rate_tmac, rate_cam = (_rate_of_turn(stream, step_s, span_s) for stream in (tmac, cam))
    products = correlate(rate_tmac, rate_cam, method="fft")
    squares_tmac = correlate(rate_tmac**2, np.ones_like(rate_cam), method="fft")
    squares_cam = correlate(np.ones_like(rate_tmac), rate_cam**2, method="fft")
    overlap = correlate(np.ones_like(rate_tmac), np.ones_like(rate_cam), method="fft")
    norms = np.sqrt(np.maximum(squares_tmac * squares_cam, np.finfo(np.float64).tiny))
    is_enough = overlap >= _LEAST_OVERLAP * min(len(rate_tmac), len(rate_cam))
    correlation = np.where(is_enough, products / norms, -1.0)
    best = int(np.argmax(correlation))
    if correlation[best] < _LEAST_CORRELATION:
        raise CalibrationError(
            f"{tmac.name} and {cam.name}: their turns do not resemble each other at any offset of"
            f" the clocks (correlation {correlation[best]:.2f}, at least {_LEAST_CORRELATION}"
            " needed); are both of one recording, and do they turn?"
        )
    lag = best - (len(rate_cam) - 1)
    return float(cam.time_s[0] - tmac.time_s[0] - lag * step_s)


def _rate_of_turn(stream: PoseStream, step_s: float, span_s: float) -> FloatArray:
    """Give the rate of turn less its mean at regular times from the first pose, shape (n,)."""
    slerp = Slerp(stream.time_s, stream.poses.rotation)
    times = np.arange(stream.time_s[0], stream.time_s[-1] - span_s, step_s)
    rates = (slerp(times).inv() * slerp(times + span_s)).magnitude() / span_s
    return rates - rates.mean()


@dataclass(frozen=True, slots=True)
class _Overlap:
    """The poses of the slower stream that lie well inside the faster one."""

    slower: PoseStream
    faster: PoseStream
    is_cam_slower: bool
    offset_s: float
    """Of which that is true."""

    def pairs_at(self, offset_s: float) -> PosePairs:
        """Interpolate the faster stream at the times of the slower one."""
        times = self.slower.time_s + (-offset_s if self.is_cam_slower else offset_s)
        interpolated = _interpolate(self.faster, times)
        if self.is_cam_slower:
            return PosePairs(interpolated, self.slower.poses)
        return PosePairs(self.slower.poses, interpolated)


def _overlap(tmac: PoseStream, cam: PoseStream, offset_s: float) -> _Overlap:
    is_cam_slower = cam.interval_s >= tmac.interval_s
    slower, faster = (cam, tmac) if is_cam_slower else (tmac, cam)
    times = slower.time_s + (-offset_s if is_cam_slower else offset_s)
    chosen = slower[_is_inside(faster, times, margin_s=slower.interval_s)]
    if len(chosen) < MIN_POSES:
        raise CalibrationError(
            f"{tmac.name} and {cam.name}: only {len(chosen)} poses were taken at the same time, at"
            f" least {MIN_POSES} needed"
        )
    return _Overlap(chosen, faster, is_cam_slower, offset_s)


def _refine(overlap: _Overlap) -> tuple[float, float]:
    """Solve for the offset together with the hand-eye transform.

    Returns:
        Offset and sigma.
    """
    offset_s = overlap.offset_s
    pairs = overlap.pairs_at(offset_s)
    starts = solve_closed_forms(pairs.trk_from_tmac, pairs.cam_from_board)
    fit = fit_pose_pairs(pairs, best_start(pairs, starts))
    for _ in range(_MAX_REFINEMENTS):
        step_s, sigma_s = _offset_step(overlap, offset_s, fit)
        offset_s += step_s
        pairs = overlap.pairs_at(offset_s)
        fit = fit_pose_pairs(pairs, fit.start, variances=fit.variances)
        if abs(step_s) < _CONVERGED_SIGMAS * sigma_s:
            return offset_s, sigma_s * np.sqrt(mean_correlation(pairs, fit))
    raise CalibrationError(
        f"{overlap.slower.name} and {overlap.faster.name}: the offset of the clocks is not"
        " determined; move faster, with turns about two axes"
    )


def _offset_step(overlap: _Overlap, offset_s: float, fit: PoseFit) -> tuple[float, float]:
    """Give the step of the offset, all transforms free, and its sigma."""
    pairs, shift_s = overlap.pairs_at(offset_s), overlap.slower.interval_s / 4
    later, earlier = (overlap.pairs_at(offset_s + s) for s in (shift_s, -shift_s))
    by_offset = (residuals(later, fit.start) - residuals(earlier, fit.start)) / (2 * shift_s)
    return one_more_unknown(pairs, fit, by_offset)


def _is_inside(stream: PoseStream, times: FloatArray, *, margin_s: float) -> NDArray[np.bool_]:
    """Tell which times lie well inside a stream and not in a gap of it."""
    after = np.clip(np.searchsorted(stream.time_s, times), 1, len(stream) - 1)
    gaps_s = stream.time_s[after] - stream.time_s[after - 1]
    is_in_range = (times >= stream.time_s[0] + margin_s) & (times <= stream.time_s[-1] - margin_s)
    return is_in_range & (gaps_s <= _GAP_INTERVALS * stream.interval_s)


def _interpolate(stream: PoseStream, times: FloatArray) -> RigidTransform:
    times = np.clip(times, stream.time_s[0], stream.time_s[-1])
    rotations: Rotation = Slerp(stream.time_s, stream.poses.rotation)(times)
    translations = [np.interp(times, stream.time_s, axis) for axis in stream.poses.translation.T]
    return RigidTransform.from_components(np.stack(translations, axis=1), rotations)


def _overlap_notes(tmac: PoseStream, cam: PoseStream, offset_s: float) -> Iterator[str]:
    """Say what one stream has before and after the other, and which gaps there are."""
    starts = tmac.time_s[0], cam.time_s[0] - offset_s
    ends = tmac.time_s[-1], cam.time_s[-1] - offset_s
    before_s, after_s = abs(starts[0] - starts[1]), abs(ends[0] - ends[1])
    earlier = tmac.name if starts[0] < starts[1] else cam.name
    later = tmac.name if ends[0] > ends[1] else cam.name
    yield f"{earlier} starts {before_s:.3f} s before the other, {later} ends {after_s:.3f} s after"
    for stream in (tmac, cam):
        gaps_s = np.diff(stream.time_s)
        is_gap = gaps_s > _GAP_INTERVALS * stream.interval_s
        if is_gap.any():
            yield (
                f"{stream.name}: {is_gap.sum()} gaps of {gaps_s[is_gap].min():.2f} to"
                f" {gaps_s[is_gap].max():.2f} s, not interpolated over"
            )
