"""Navigation cores that do what a test asks for; worker processes import them from here."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.nav.specs import CoreSpec
from tronlab.score.rescoring.keys import core_key
from tronlab.score.rescoring.opening import ScoredCore

FIXED = RigidTransform.from_translation([1.1, 2.1, 4.01])


class FakeCore(ScoredCore):
    """Opens the core of this file that its target names."""

    def open(self, context: CoreContext, *, limit_s: float) -> "Located":
        context = replace(context, settings=self.spec.settings, seed=self.spec.seed)
        return CORES[self.spec.target](context)


class Located:
    """A core of one function; writes down which frames it was shown."""

    name = "fake"

    def __init__(self, answer: Callable[[Frame], object], context: CoreContext) -> None:
        self._answer = answer
        self._log = context.settings.get("log")

    def locate(self, frame: Frame) -> NavigationResult:
        if self._log:
            with Path(str(self._log)).open("a") as log:
                log.write(f"{frame.number} ")
        return self._answer(frame)  # pyright: ignore[reportReturnType]


class Counting(Located):
    """Keeps state: its answers depend on how many frames it saw since it was reset."""

    def __init__(self, context: CoreContext) -> None:
        super().__init__(self._count, context)
        self._stumbles_at = context.settings.get("stumbles_at")
        self._n = -100

    def reset(self) -> None:
        self._n = 0

    def _count(self, frame: Frame) -> NavigationResult:
        self._n += 1
        if self._n == self._stumbles_at:
            raise ValueError("lost count")
        return NavigationResult("ok", RigidTransform.from_translation([0, 0, self._n]))


def shift(context: CoreContext) -> Located:
    """Says every camera is 1 cm above a fixed pose; behaves badly where told to."""
    start = int(str(context.settings.get("start", 0)))

    def answer(frame: Frame) -> object:
        return {
            1: lambda: np.linalg.inv(np.zeros((2, 2))),
            2: lambda: NavigationResult("no_pose", reason="too dark", n_features=7),
            3: lambda: NavigationResult("ok"),
            4: lambda: None,
        }.get(frame.number + start, lambda: with_inliers(FIXED))()

    return Located(answer, context)


def with_inliers(pose: RigidTransform) -> NavigationResult:
    uv = np.array([[1.0, 2], [3, 4]])
    landmarks = np.array([5, 7])
    return NavigationResult(
        "ok",
        pose,
        np.eye(6),
        n_features=9,
        n_inliers=2,
        uv_inliers=uv,
        landmark_inliers=landmarks,
        database="of landmarks",
    )


def good(context: CoreContext) -> Located:
    """Answers by seed and image, never fails."""
    rng = np.random.default_rng(context.seed)
    offset = float(rng.normal())

    def answer(frame: Frame) -> NavigationResult:
        z_m = 4.0 + offset + float(frame.image.mean()) / 1000
        return with_inliers(RigidTransform.from_translation([1.1, 2.1, z_m]))

    return Located(answer, context)


def follows(context: CoreContext) -> Located:
    """Answers the prior, moved by a metre; without one, the origin."""

    def answer(frame: Frame) -> NavigationResult:
        if frame.number == context.settings.get("fails_at"):
            raise ValueError("out of luck")
        if frame.prior is None:
            return NavigationResult("ok", RigidTransform.identity())
        moved = RigidTransform.from_translation([1.0, 0, 0]) * frame.prior.trs_from_cam
        return NavigationResult("ok", moved, frame.prior.covariance)

    return Located(answer, context)


def broken(context: CoreContext) -> Located:
    raise ScoreError("core 'broken' has no licence")


def interrupted(context: CoreContext) -> Located:
    def answer(frame: Frame) -> NavigationResult:
        if frame.number == 1:
            raise KeyboardInterrupt
        return with_inliers(FIXED)

    return Located(answer, context)


def crashes(context: CoreContext) -> Located:
    """Takes its process with it, at the frames it is told; at all if it is told none."""
    frames = context.settings.get("frames")

    def answer(frame: Frame) -> NavigationResult:
        if not isinstance(frames, Sequence) or frame.number in frames:
            os.kill(os.getpid(), signal.SIGSEGV)
        return with_inliers(FIXED)

    return Located(answer, context)


def deaf(context: CoreContext) -> Located:
    """Does not come back from the second frame, as code in C that no signal interrupts."""

    def answer(frame: Frame) -> NavigationResult:
        if frame.number == 1:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
            time.sleep(60)
        return with_inliers(FIXED)

    return Located(answer, context)


def slow(context: CoreContext) -> Located:
    def answer(frame: Frame) -> NavigationResult:
        time.sleep(0.2)
        return with_inliers(FIXED)

    return Located(answer, context)


def hangs(context: CoreContext) -> Located:
    def answer(frame: Frame) -> NavigationResult:
        while True:
            with suppress(Exception):  # a core that swallows what it can
                time.sleep(0.01)

    return Located(answer, context)


def dies_when_opened(context: CoreContext) -> Located:
    os._exit(9)


CORES: dict[str, Callable[[CoreContext], Located]] = {
    "shift": shift,
    "third": shift,
    "too-dark": shift,
    "good": good,
    "follows": follows,
    "counting": Counting,
    "broken": broken,
    "interrupted": interrupted,
    "crashes": crashes,
    "deaf": deaf,
    "hangs": hangs,
    "slow": slow,
    "dies": dies_when_opened,
}


def describe_fakes(specs: Sequence[CoreSpec]) -> tuple[ScoredCore, ...]:
    """What stands for ``describe_cores``."""
    return tuple(
        FakeCore(spec, core_key(spec, "fake"), is_sequential=spec.target == "counting")
        for spec in specs
    )
