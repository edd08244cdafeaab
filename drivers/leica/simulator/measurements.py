"""Measurements: stationary ones, which give one result, and continuous ones, which give many."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from itertools import count
from typing import Final

import numpy as np

from drivers.leica.simulator import packets, results
from drivers.leica.simulator.codes import Command, Event, Mode, Status
from drivers.leica.simulator.faults import (
    BEAM_BREAKS,
    ERROR_PACKET,
    POSE_INVALID,
    PROBE_MISSING,
)
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.tracker import RefusedError, Tracker
from tronlab.errors import DeviceFaultError, TrackingLostError
from tronlab.twin.state import Faults
from tronlab.twin.truth import named_rng

_NIVEL_S: Final = 0.2
_TILT_SIGMA_RAD: Final = 20e-6
_DISTANCE_POLL_MS: Final = 10
_MOST_SAMPLES: Final = 256
"""A packet: more would not fit into what clients call sane."""
_HAVE_DISTANCE_MODE: Final = (Mode.CONTINUOUS_DISTANCE, Mode.PROBE_CONTINUOUS_DISTANCE)


class Measurements:
    """What StartMeasurement does in each mode."""

    def __init__(self, tracker: Tracker, faults: Faults, send: Callable[[bytes], None]) -> None:
        self._tracker = tracker
        self._faults = faults
        self._send = send
        self._failure: int | None = None
        """Status of the error that will end the measurement in place of a result."""

    def check(self) -> None:
        """Return if a measurement can begin now.

        Raises:
            RefusedError: It cannot.
            DeviceTimeoutError: A script says that there shall be no answer.
        """
        tracker, self._failure = self._tracker, None
        is_probe = tracker.settings.mode.is_probe
        if is_probe and self._faults.strike(PROBE_MISSING):
            raise RefusedError(Status.NO_PROBE)
        mismatch = tracker.mismatch
        if mismatch is not None:
            raise RefusedError(mismatch)
        if is_probe and tracker.settings.tip_rule != 1:
            raise RefusedError(Status.NO_TIP)
        if not tracker.settings.mode.is_continuous:
            self._begin("measure_pose" if is_probe else "measure_point")

    async def measure(self) -> None:
        """Measure in the client's mode, until done or cancelled."""
        if self._tracker.settings.mode.is_continuous:
            await self._measure_continuously()
        else:
            await self._measure_stationary()

    async def measure_nivel(self) -> None:
        """Measure the inclination; it is drawn once."""
        await asyncio.sleep(_NIVEL_S)
        rng = named_rng(self._tracker.scene.serial, "inclination of the tracker")
        self._send(results.nivel(self._tracker, _TILT_SIGMA_RAD * rng.standard_normal(2)))

    def break_beam(self) -> None:
        """Lose the target, and say so: real trackers do as command 64 with status 701."""
        self._tracker.lose_beam()
        self._send(packets.error(Command.UNKNOWN, Status.BEAM_BROKEN))

    def _begin(self, call: str) -> None:
        """Ask the script of the scene, and the faults that end a measurement."""
        if self._faults.strike(BEAM_BREAKS):
            self._failure = Status.BEAM_BROKEN
        elif self._faults.strike(ERROR_PACKET):
            self._failure = Status.NO_STATIONARY_RESULT
        try:
            self._tracker.scene.begin(call)
        except TrackingLostError:
            self._failure = Status.BEAM_BROKEN
        except DeviceFaultError as fault:
            self._failure = fault.code

    async def _measure_stationary(self) -> None:
        """Look in the middle of the time; the beam must not break until its end."""
        half_s = self._tracker.settings.stationary_ms / 2000.0
        await asyncio.sleep(half_s)
        result = None if self._is_beam_breaking else self._stationary_result()
        await asyncio.sleep(half_s)
        if result is None or self._is_beam_breaking:
            self.break_beam()
        else:
            self._send(result)

    @property
    def _is_beam_breaking(self) -> bool:
        return self._failure == Status.BEAM_BROKEN or self._tracker.is_beam_broken

    def _stationary_result(self) -> bytes:
        tracker = self._tracker
        if self._failure is not None:
            return packets.error(Command.START_MEASUREMENT, self._failure)
        if not tracker.settings.mode.is_probe:
            return results.stationary_point(tracker, tracker.measure_point())
        result = results.stationary_pose(tracker, tracker.measure_pose())
        if self._faults.strike(POSE_INVALID) and not tracker.settings.show_all_probe_results:
            return packets.error(Command.START_MEASUREMENT, Status.BAD_PROBE_RESULT)
        return result

    async def _measure_continuously(self) -> None:
        """Send packets of samples, each as many as came together."""
        settings = self._tracker.settings
        by_distance = settings.mode in _HAVE_DISTANCE_MODE
        n_wanted = settings.distance_count if by_distance else settings.separation_count
        samples: list[Values] = []
        n_taken, sent_s = 0, time.monotonic()
        async for sample in self._samples(by_distance=by_distance):
            if sample is not None:
                samples.append(sample)
                n_taken += 1
            is_last = n_taken == n_wanted > 0
            is_due = time.monotonic() - sent_s >= 1.0 / settings.packets_per_s
            if samples and (is_last or is_due or len(samples) >= _MOST_SAMPLES):
                self._send(results.continuous(self._tracker, samples))
                samples, sent_s = [], time.monotonic()
            if is_last:
                break
        if settings.send_unsolicited:
            self._send(packets.event(Event.COUNT_REACHED))

    async def _samples(self, *, by_distance: bool) -> AsyncGenerator[Values | None]:
        """Give a sample at every step of time; None where there is none to give."""
        settings = self._tracker.settings
        step_s = (_DISTANCE_POLL_MS if by_distance else settings.separation_ms) / 1000.0
        begin_s, p_last_m = time.monotonic(), None
        for n in count(1):
            await asyncio.sleep(max(0.0, begin_s + n * step_s - time.monotonic()))
            p_m = self._tracker.p_beam_m
            if by_distance and p_last_m is not None:
                moved_m = float(np.linalg.norm(p_m - p_last_m))
                if moved_m < settings.distance_m:
                    yield None
                    continue
            p_last_m = p_m
            yield self._sample(begin_s + n * step_s)

    def _sample(self, time_s: float) -> Values | None:
        """Take one sample; one whose rotation is invalid is held back unless all are wanted."""
        tracker = self._tracker
        if not tracker.settings.mode.is_probe:
            return results.point_sample(tracker, tracker.measure_point(), time_s)
        if not tracker.is_pose_valid and not tracker.settings.show_all_probe_results:
            return None
        return results.pose_sample(tracker, tracker.measure_pose(), time_s)
