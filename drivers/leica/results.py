"""What a tracker measures: everything after the status of a result."""

from dataclasses import dataclass

from drivers.leica.replies import Environment
from drivers.leica.wire import F64, I32, U32, Quadruple, Triple, decode, size_of


@dataclass(frozen=True, slots=True)
class PointResult:
    """A stationary point; angles, lengths, air in the units set."""

    mode: U32
    is_try_mode: U32
    position: Triple
    std: Triple
    std_total: F64
    pointing_error: Triple
    a_priori_std: Triple
    a_priori_total: F64
    temperature: F64
    pressure: F64
    humidity: F64

    @property
    def covariance(self) -> tuple[float, float, float]:
        """Get xy, xz, yz: standard statistics do not tell, so none."""
        return 0.0, 0.0, 0.0


@dataclass(frozen=True, slots=True)
class ExtendedPointResult:
    """A stationary point with extended statistics."""

    mode: U32
    is_try_mode: U32
    position: Triple
    std: Triple
    std_total: F64
    covariance: Triple
    """xy, xz, yz."""
    pointing_error: Triple
    a_priori_std: Triple
    a_priori_total: F64
    a_priori_covariance: Triple
    temperature: F64
    pressure: F64
    humidity: F64


@dataclass(frozen=True, slots=True)
class PoseResult:
    """A stationary pose of a probe."""

    mode: U32
    is_try_mode: U32
    trigger: U32
    rotation_status: I32
    probe_id: I32
    field: I32
    tip_status: U32
    tip_adapter_id: I32
    tip_interface: I32
    position: Triple
    std: Triple
    std_total: F64
    covariance: Triple
    a_priori_std: Triple
    a_priori_total: F64
    a_priori_covariance: Triple
    quaternion: Quadruple
    """Scalar first; turns vectors of the probe into vectors of the tracker."""
    angles: Triple
    """About X, Y, Z; in which order nobody says, so they are never used."""
    angle_std: Triple
    angle_std_total: F64
    angle_covariance: Triple
    a_priori_angle_std: Triple
    a_priori_angle_total: F64
    a_priori_angle_covariance: Triple
    temperature: F64
    pressure: F64
    humidity: F64

    @property
    def environment(self) -> Environment:
        """Get the air of the measurement."""
        return Environment(self.temperature, self.pressure, self.humidity)


@dataclass(frozen=True, slots=True)
class StreamHead:
    """What all poses of one packet of a stream have in common."""

    n_samples: I32
    mode: U32
    is_try_mode: U32
    probe_id: I32
    field: I32
    tip_status: U32
    tip_adapter_id: I32
    tip_interface: I32
    temperature: F64
    pressure: F64
    humidity: F64


@dataclass(frozen=True, slots=True)
class StreamedPose:
    """One pose of a stream."""

    point_status: U32
    trigger: U32
    rotation_status: I32
    time_s: I32
    """Whole seconds of the tracker's clock, whose zero is anywhere."""
    time_us: I32
    position: Triple
    std: Triple
    std_total: F64
    covariance: Triple
    quaternion: Quadruple
    angles: Triple
    angle_std: Triple
    angle_std_total: F64
    angle_covariance: Triple


def decode_stream(body: bytes) -> tuple[StreamedPose, ...]:
    """Read the poses of one packet of a stream.

    Raises:
        ValueError: The number of poses it states and its length do not fit.
    """
    n_head, n_sample = size_of(StreamHead), size_of(StreamedPose)
    head = decode(StreamHead, body[:n_head])
    if len(body) != n_head + head.n_samples * n_sample:
        raise ValueError(f"{head.n_samples} poses stated, got {len(body)} bytes")
    return tuple(
        decode(StreamedPose, body[start : start + n_sample])
        for start in range(n_head, len(body), n_sample)
    )
