"""One shot and cores that misbehave: each becomes a result with its reason, and nothing is lost."""

import time
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.score.rescoring.shot import locate

FRAME = Frame(np.zeros((4, 6), np.uint8), np.ones((4, 6), np.bool_))


@pytest.fixture
def context(small_camera: CameraModel) -> CoreContext:
    return CoreContext(small_camera, ())


def test_a_good_answer_is_passed_on(fakes: ModuleType, context: CoreContext) -> None:
    assert locate(fakes.good(context), FRAME).status == "ok"


@pytest.mark.parametrize("n_threads", [0, 1])
def test_a_core_that_hangs_is_a_timeout_and_the_next_shot_has_its_full_time(
    fakes: ModuleType, context: CoreContext, n_threads: int
) -> None:
    def score() -> tuple[str, str, str]:
        result = locate(fakes.hangs(context), FRAME, limit_s=0.05)
        good = locate(fakes.good(context), FRAME, limit_s=0.02)
        time.sleep(0.06)  # an alarm left behind would ring now
        return result.status, result.reason, good.status

    if n_threads:  # those of a Dask worker
        with ThreadPoolExecutor(n_threads) as threads:
            found = threads.submit(score).result()
    else:
        found = score()
    assert found == ("timeout", "no answer within 0.05 s", "ok")


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (lambda: NavigationResult("ok"), "ok"),
        (lambda: None, "NoneType"),
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda: (_ for _ in ()).throw(SystemExit(3)), "SystemExit: 3"),
        (lambda: (_ for _ in ()).throw(MemoryError("too much")), "MemoryError: too much"),
    ],
)
def test_an_answer_that_makes_no_sense_is_an_error_with_its_reason(
    fakes: ModuleType, context: CoreContext, answer, reason: str
) -> None:
    result = locate(fakes.Located(lambda _: answer(), context), FRAME)
    assert result.status == "error"
    assert reason in result.reason


def test_a_sequence_begins_with_a_reset_whose_failure_is_a_result(
    fakes: ModuleType, context: CoreContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = fakes.Counting(context)
    poses = [locate(core, FRAME, is_first=first).trs_from_cam for first in (True, False, True)]
    assert [pose.translation[2] for pose in poses if pose is not None] == [1, 2, 1]
    monkeypatch.setattr(core, "reset", lambda: 1 / 0)
    assert locate(core, FRAME, is_first=True).status == "error"
