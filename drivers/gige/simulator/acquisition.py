"""Taking frames: waits for triggers and exposes, in real time."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drivers.gige.simulator.clock import DeviceClock
from drivers.gige.simulator.gvsp import Frame, next_block_id
from drivers.gige.simulator.registers import Settings
from drivers.gige.simulator.scene import Exposure, Scene
from tronlab.errors import TronlabError

_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Shot:
    """An exposure that has begun."""

    settings: Settings
    start_s: float


@dataclass
class _Run:
    """One acquisition, from its start to its end."""

    is_running: bool = True
    is_aborted: bool = False
    shot: _Shot | None = None
    """The exposure going on."""
    is_triggered_early: bool = False
    """Whether the next exposure shall begin as soon as it can."""
    ready_s: float = 0.0
    """When the last frame has been read out."""

    @property
    def is_alive(self) -> bool:
        """Tell whether it still gives a frame."""
        return not self.is_aborted and (self.is_running or self.shot is not None)

    def earliest_s(self, settings: Settings) -> float:
        """Give when the next exposure may begin: it must not end before the read-out does."""
        return self.ready_s - settings.exposure_s


@dataclass(frozen=True, slots=True)
class ReadOut:
    """A frame on its way to the stream."""

    frame: Frame
    ready_s: float
    """When it can be sent, in ``time.perf_counter``."""
    is_wanted: Callable[[], bool]
    """Tells whether its acquisition has not been aborted, nor the next one started, meanwhile."""


class Acquisition:
    """Exposes frames in a thread of its own and hands them on.

    Times are of ``time.perf_counter``.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        settings: Callable[[], Settings],
        deliver: Callable[[ReadOut], None],
        ignores_trigger: Callable[[], bool],
        clock: DeviceClock,
        readout_s: float,
        first_block_id: int,
    ) -> None:
        """Make it ready; nothing is exposed before ``start``.

        Args:
            scene: What the camera sees.
            settings: Gives how frames are taken at this moment.
            deliver: Takes each frame; may block.
            ignores_trigger: Tells whether the trigger that has just come is ignored.
            clock: The camera's clock.
            readout_s: From the end of an exposure until its frame can be sent.
            first_block_id: Block id of the first frame of every acquisition.
        """
        self._scene = scene
        self._settings = settings
        self._deliver = deliver
        self._ignores_trigger = ignores_trigger
        self._clock = clock
        self._readout_s = readout_s
        self._first_block_id = first_block_id
        self._changed = threading.Condition()
        self._run: _Run | None = None
        self._is_closed = False
        self._thread = threading.Thread(target=self._work, name="camera exposure", daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Tell whether frames are being taken."""
        with self._changed:
            return self._run is not None and self._run.is_running

    def start(self) -> None:
        """Begin an acquisition; frames of the one before are not wanted any more."""
        with self._changed:
            self._end(is_aborted=True)
            self._run = _Run()
            self._changed.notify_all()

    def stop(self) -> None:
        """End the acquisition; an exposure that has begun becomes a frame."""
        with self._changed:
            self._end(is_aborted=False)

    def abort(self) -> None:
        """End the acquisition at once."""
        with self._changed:
            self._end(is_aborted=True)

    def trigger(self) -> None:
        """Trigger by software: take a frame, if the camera waits for that.

        The exposure begins now, whenever the thread gets to it.
        """
        with self._changed:
            run, settings, now_s = self._run, self._settings(), time.perf_counter()
            if run is None or not run.is_running or not settings.heeds_software:
                return
            if run.shot is None and now_s >= run.ready_s:
                run.shot = _Shot(settings, now_s + settings.trigger_delay_s)
            elif settings.keeps_early_trigger:
                run.is_triggered_early = True
            self._changed.notify_all()

    def reconsider(self) -> None:
        """Heed changed settings while waiting for a trigger."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """End everything, and the thread."""
        with self._changed:
            self._end(is_aborted=True)
            self._is_closed = True
            self._changed.notify_all()
        self._thread.join()

    def _end(self, *, is_aborted: bool) -> None:
        if self._run is not None:
            self._run.is_running = False
            self._run.is_aborted |= is_aborted
            self._changed.notify_all()

    def _work(self) -> None:
        while (run := self._next_run()) is not None:
            self._acquire(run)

    def _next_run(self) -> _Run | None:
        with self._changed:
            self._changed.wait_for(
                lambda: self._is_closed or (self._run is not None and self._run.is_alive)
            )
            return None if self._is_closed else self._run

    def _acquire(self, run: _Run) -> None:
        block_id, n_left = self._first_block_id, self._settings().n_frames
        due_s = time.perf_counter()
        while (shot := self._await_shot(run, due_s)) is not None:
            if shot.settings.waits_for_trigger and self._ignores_trigger():
                self._drop(run)
                continue
            # A camera that cannot keep up goes on from now instead of catching up.
            period_s = shot.settings.period_s
            due_s = max(due_s, shot.start_s - period_s) + period_s
            frame = self._expose(run, block_id, shot)
            block_id = next_block_id(block_id)
            n_left = None if n_left is None else n_left - 1
            ready_s = self._finish(run, is_last=n_left == 0)
            if frame is not None:
                self._deliver(ReadOut(frame, ready_s, lambda: not run.is_aborted))

    def _drop(self, run: _Run) -> None:
        """Go on as if the exposure had never begun."""
        with self._changed:
            run.shot = None

    def _finish(self, run: _Run, *, is_last: bool) -> float:
        """End an exposure; give when it has been read out."""
        with self._changed:
            run.shot = None
            run.is_running &= not is_last
            run.ready_s = max(run.ready_s, time.perf_counter()) + self._readout_s
            return run.ready_s

    def _await_shot(self, run: _Run, due_s: float) -> _Shot | None:
        """Wait until an exposure begins; None if none does any more."""
        with self._changed:
            while run.is_alive:
                if run.shot is not None:
                    return run.shot
                settings = self._settings()
                wait_s = self._begin(run, settings, due_s)
                if run.shot is None:
                    self._changed.wait(wait_s)
        return None

    def _begin(self, run: _Run, settings: Settings, due_s: float) -> float | None:
        """Begin an exposure if it is time; else give how long to wait, None: for a trigger."""
        if settings.waits_for_trigger and not run.is_triggered_early:
            return None
        begin_s = run.earliest_s(settings)
        if not settings.waits_for_trigger:
            begin_s = max(begin_s, due_s)
        now_s = time.perf_counter()
        if begin_s <= now_s:
            delay_s = settings.trigger_delay_s if settings.waits_for_trigger else 0.0
            run.shot = _Shot(settings, now_s + delay_s)
            run.is_triggered_early = False
        return begin_s - now_s

    def _expose(self, run: _Run, block_id: int, shot: _Shot) -> Frame | None:
        """Take one frame; None if it was aborted, or the scene cannot be seen."""
        settings = shot.settings
        self._pause(run, shot.start_s + settings.exposure_s / 2)
        if run.is_aborted:
            return None
        try:
            image = self._scene.image(
                Exposure(
                    block_id=block_id,
                    region=settings.region,
                    exposure_s=settings.exposure_s,
                    gain_db=settings.gain_db,
                    pixel_format=settings.scene_format,
                )
            )
        except TronlabError as error:
            _LOG.error("no frame: %s", error)
            return None
        self._pause(run, shot.start_s + settings.exposure_s)
        return Frame(
            block_id=block_id,
            timestamp_ticks=self._clock.ticks_at(shot.start_s),
            pixel_format=settings.pixel_format,
            left_px=settings.region.left_px,
            top_px=settings.region.top_px,
            image=image,
        )

    def _pause(self, run: _Run, until_s: float) -> None:
        """Wait, unless aborted."""
        with self._changed:
            while not run.is_aborted and (wait_s := until_s - time.perf_counter()) > 0:
                self._changed.wait(wait_s)
