"""From packets to readings, or to the error of a result that cannot be used."""

import time
from collections.abc import Callable
from typing import Final, TypeVar

from drivers.leica.beam import Measured
from drivers.leica.codes import PacketType, rotation_problem
from drivers.leica.connection import Connection
from drivers.leica.packets import Packet
from drivers.leica.readings import (
    StreamedPoseReading,
    point_reading,
    pose_reading,
    streamed_pose_reading,
)
from drivers.leica.results import (
    ExtendedPointResult,
    PointResult,
    PoseResult,
    StreamedPose,
    decode_stream,
)
from tronlab.devices.accuracy import StatedAccuracy
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.errors import TrackingLostError

T = TypeVar("T")

_LAST_GOOD_POINT_STATUS: Final = 1
"""0 is good, 1 a warning of speed; what is above is no measurement."""


class Interpreter:
    """Reads results; every method raises ProtocolError for one that makes no sense."""

    def __init__(self, connection: Connection, accuracy: StatedAccuracy, *, device: str) -> None:
        self._connection = connection
        self._accuracy = accuracy
        self._device = device

    def point(self, measured: Measured, *, target: str) -> PointReading:
        """Read a point, with standard or extended statistics."""
        packet = measured.packet
        if packet.type == PacketType.POINT:
            result = self._connection.read(PointResult, packet)
        else:
            self._expect(PacketType.POINT_EXTENDED, packet)
            result = self._connection.read(ExtendedPointResult, packet)
        return self._checked(
            lambda: point_reading(result, self._accuracy, target=target, time_s=measured.time_s),
            packet,
        )

    def pose(self, measured: Measured) -> PoseReading:
        """Read a pose.

        Raises:
            TrackingLostError: Its rotation is not determined.
        """
        self._expect(PacketType.POSE, measured.packet)
        result = self._connection.read(PoseResult, measured.packet)
        self._check_rotation(result.rotation_status)
        return self._checked(
            lambda: pose_reading(result, self._accuracy, time_s=measured.time_s), measured.packet
        )

    def poses(self, packet: Packet) -> list[StreamedPoseReading]:
        """Read the poses of one packet of a stream.

        Raises:
            TrackingLostError: One of them is bad, or its rotation not determined.
        """
        self._expect(PacketType.POSE_STREAM, packet)
        received_s = time.time()
        results = self._connection.read_by(decode_stream, packet)
        return [self._streamed_pose(result, packet, received_s) for result in results]

    def _streamed_pose(
        self, result: StreamedPose, packet: Packet, received_s: float
    ) -> StreamedPoseReading:
        if result.point_status > _LAST_GOOD_POINT_STATUS:
            raise TrackingLostError(
                f"{self._connection.call}: the tracker calls a pose bad (point status"
                f" {result.point_status}); move slower, or clear the beam",
                device=self._device,
            )
        self._check_rotation(result.rotation_status)
        return self._checked(
            lambda: streamed_pose_reading(result, self._accuracy, received_s=received_s), packet
        )

    def _check_rotation(self, rotation_status: int) -> None:
        problem = rotation_problem(rotation_status)
        if problem is not None:
            raise TrackingLostError(
                f"{self._connection.call}: the rotation is not determined: {problem} (rotation"
                f" status {rotation_status:#x}); turn the T-MAC to the tracker",
                device=self._device,
            )

    def _expect(self, expected: PacketType, packet: Packet) -> None:
        if packet.type != expected:
            self._connection.refuse(
                f"a result of type {packet.type}, expected {expected.value}", packet
            )

    def _checked(self, make: Callable[[], T], packet: Packet) -> T:
        try:
            return make()
        except ValueError as error:
            self._connection.refuse(str(error), packet)
