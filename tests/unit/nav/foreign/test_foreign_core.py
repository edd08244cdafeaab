"""Programs as cores: whatever they do is a result with a reason, and the run goes on."""

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from plain_cores import frame, is_gone, place, plain
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext, NavigationResult, PosePrior, SequentialCore
from tronlab.nav.foreign import ForeignCore, describe_core, open_core
from tronlab.nav.foreign.core import MOST_FAILURES
from tronlab.nav.specs import CoreSpec

Opened = Callable[..., ForeignCore]


def position(result: NavigationResult) -> list[float]:
    assert result.status == "ok", result.reason
    assert result.trs_from_cam is not None
    return result.trs_from_cam.translation.tolist()


@pytest.mark.parametrize("words", [(), ("--shared",), ("--references", "--shared")])
def test_a_program_sees_the_frame_whichever_way_it_travels(
    opened: Opened, words: tuple[str, ...]
) -> None:
    core = opened(plain(*words))
    n_references = 2 if "--references" in words else 0
    for i in range(3):
        assert position(core.locate(frame(i))) == place(frame(i), n_references)
    large = frame(3, shape=(120, 90))  # not what the camera delivers: no room in the memory
    result = core.locate(large)
    assert position(result) == place(large, n_references)
    parts = json.loads(result.reason)["parts"]
    assert {part["where"] for part in parts} == {"payload"}
    assert 0.0 < result.time_pose_s < 20.0  # it measured nothing itself
    assert (core.name, isinstance(core, SequentialCore)) == ("plain", True)


def test_prior_and_time_go_with_the_frame(opened: Opened) -> None:
    core = opened(plain())
    prior = PosePrior(RigidTransform.from_translation([1.0, 2.0, 3.0]), np.eye(6) / 7)
    told = json.loads(core.locate(frame(0, time_s=1.5e9, prior=prior)).reason)
    assert told["time_s"] == 1.5e9
    assert told["prior"]["pose"]["position_m"] == [1.0, 2.0, 3.0]
    assert told["prior"]["covariance"] == (np.eye(6) / 7).ravel().tolist()
    told = json.loads(core.locate(frame(1)).reason)
    assert (told["time_s"], told["prior"]) == (None, None)


@pytest.mark.parametrize(
    ("words", "expected"), [(("--sequential",), [0, 1, 0, 1]), ((), [0, 1, 2, 3])]
)
def test_a_core_with_state_is_told_of_a_new_sequence(
    opened: Opened, words: tuple[str, ...], expected: list[int]
) -> None:
    core = opened(plain(*words))
    core.reset()  # nothing to forget yet
    counts: list[int] = []
    for number in (0, 1, 0, 1):
        if number == 0:
            core.reset()
        counts.append(json.loads(core.locate(frame(number)).reason)["since_reset"])
    assert counts == expected


FATAL = (
    ("segfault", "error", r"ended without an answer; signal 11 \(Segmentation fault\)"),
    ("exit3", "error", "ended without an answer; exit code 3; its last words: out of fuel$"),
    ("half_and_exit", "error", "in the middle of a message, after 100 bytes; exit code 0"),
    ("closed", "error", "ended without an answer; it still runs"),
    ("printing", "error", r'the core wrote "Loading model\.\.\." to standard output, which'
     " carries the messages; print to standard error$"),
    ("noise", "error", "wrote bytes c8 c9 ca .*to standard output"),
    ("endless", "error", "announced a payload of 4611686018427387904 bytes; at most 67108864"),
    ("long_header", "error", "announced a header of 4294967295 bytes"),
    ("no_json", "error", "sent a header that is no JSON"),
    ("other_number", "error", r"answered frame 20, asked was 19"),
    ("other_type", "error", "sent a message of type 'ready', expected result"),
    ("stop", "timeout", "no answer within 0.1 s, nor in another 0.1 s: it is silent"),
    ("half", "timeout", r"no answer within .* it sent 100 of \d+ bytes"),
    ("crumbs", "timeout", r"no answer within .* it sent \d+ of \d+ bytes"),
)  # fmt: skip


def test_a_failure_has_a_reason_and_the_next_frame_a_new_process(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second frame fails, in another way each."""
    core = opened(plain(*(f"{2 * i + 1}={what}" for i, (what, _, _) in enumerate(FATAL))))
    pids = [json.loads(core.locate(frame(0)).reason)["pid"]]
    for number, (what, status, reason) in zip(range(1, 99, 2), FATAL, strict=False):
        with monkeypatch.context() as patch:
            if status == "timeout":
                patch.setattr(core, "_limit_s", 0.1)
            failed = core.locate(frame(number))
        assert (what, failed.status, failed.trs_from_cam) == (what, status, None)
        assert re.search(reason, failed.reason), failed.reason
        assert is_gone(pids[-1])
        after = core.locate(frame(number + 1))
        assert position(after) == place(frame(number + 1))
        pids.append(json.loads(after.reason)["pid"])
    assert len(set(pids)) == len(FATAL) + 1


USELESS = (
    ("not_a_number", "error", r"cannot be used: .*not finite: \[0.0, nan, 1.0"),
    ("other_frames", "error", "parent 'cam' and child 'trs'; it must be trs_from_cam"),
    ("long_quaternion", "error", r"the quaternion's norm is 1\.0049.*, expected 1"),
    ("parts_beyond", "error", "part 'uv_inliers': reaches to byte 160 of the payload"),
    ("covariance", "error", "covariance has a variance below 0"),
    ("late", "timeout", r"answered 0\.\d+ s after the limit of 0.4 s"),
    ("loud", "ok", "since_reset"),
)


def test_an_answer_of_no_use_keeps_the_process(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = opened(plain(*(f"{i}={what}" for i, (what, _, _) in enumerate(USELESS))))
    for number, (what, status, reason) in enumerate(USELESS):
        with monkeypatch.context() as patch:
            if status == "timeout":
                patch.setattr(core, "_limit_s", 0.4)
            result = core.locate(frame(number))
        assert (what, result.status) == (what, status)
        assert re.search(reason, result.reason), result.reason
    after = core.locate(frame(len(USELESS)))
    assert position(after) == place(frame(len(USELESS)))
    assert json.loads(after.reason)["since_reset"] == len(USELESS)  # in one and the same process


def test_an_answer_too_many_is_not_taken_for_the_next_frame(opened: Opened) -> None:
    core = opened(plain("0=twice"))
    assert core.locate(frame(0)).status == "ok"
    sleep(0.02)
    between = core.locate(frame(1))
    assert between.status == "error"
    assert "spoke before it was asked" in between.reason
    assert position(core.locate(frame(2))) == place(frame(2))


def test_a_core_that_ended_meanwhile_is_not_said_to_have_seen_the_frame(opened: Opened) -> None:
    core = opened(plain("0=answer_and_exit"))
    assert is_gone(json.loads(core.locate(frame(0)).reason)["pid"])
    between = core.locate(frame(1))
    assert between.reason == (
        "the core ended after its last answer, before it was asked again; exit code 4"
    )
    assert position(core.locate(frame(2))) == place(frame(2))


def test_a_core_that_does_not_read_is_late(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    core = opened(plain("0=deaf"))
    assert core.locate(frame(0)).status == "ok"
    monkeypatch.setattr(core, "_limit_s", 0.1)
    deaf = core.locate(frame(1, shape=(800, 900)))  # more than a pipe holds
    assert (deaf.status, "did not read what it was sent" in deaf.reason) == ("timeout", True)


def test_children_of_a_core_end_with_it(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    core = opened(plain("0=with_child", "1=stop", "2=with_child"))
    first = int(core.locate(frame(0)).reason)
    assert not is_gone(first, within_s=0.0)
    with monkeypatch.context() as patch:
        patch.setattr(core, "_limit_s", 0.1)
        assert core.locate(frame(1)).status == "timeout"
    assert is_gone(first)
    second = int(core.locate(frame(2)).reason)
    core.close()
    assert is_gone(second)


def test_after_five_failures_in_a_row_a_core_is_asked_no_more(opened: Opened) -> None:
    core = opened(plain("1=exit3", *(f"{n}=exit3" for n in range(3, 8))))
    results = [core.locate(frame(n)) for n in range(3)]
    assert [result.status for result in results] == ["ok", "error", "ok"]  # counts from here
    results = [core.locate(frame(n)) for n in range(3, 3 + MOST_FAILURES + 2)]
    assert {result.status for result in results} == {"error"}
    assert ["not asked" in result.reason for result in results] == [False] * 5 + [True] * 2
    assert results[-1].reason == (
        "not asked, after 5 failures in a row: the core ended without an answer; exit code 3;"
        " its last words: out of fuel"
    )


def test_ctrl_c_while_waiting_ends_the_core(opened: Opened) -> None:
    core = opened(plain("0=with_child", "1=stop"))
    child = int(core.locate(frame(0)).reason)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    try:
        with pytest.raises(KeyboardInterrupt):
            core.locate(frame(1))
    finally:
        signal.signal(signal.SIGALRM, before)
    assert is_gone(child)
    assert position(core.locate(frame(2))) == place(frame(2))


def test_nothing_is_left_when_tronlab_is_killed(tmp_path: Path) -> None:
    """Killed while the core hangs: it reads no end of input, and still it ends, with its child."""
    spec = plain("--shared", "0=with_child", "1=stop")
    script = f"""
        import sys
        sys.path.insert(0, {str(Path(__file__).parents[3] / "support")!r})
        from plain_cores import CAMERA, frame
        from tronlab.nav.core import CoreContext
        from tronlab.nav.foreign import open_core
        from tronlab.nav.specs import CoreSpec
        core = open_core(CoreSpec("plain", "command", {spec.target!r}), CoreContext(CAMERA, ()),
                         limit_s=100.0)
        print(core.locate(frame(0)).reason, core._link.transport.pid, flush=True)
        core.locate(frame(1))
    """
    tronlab = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, cwd=tmp_path
    )
    assert tronlab.stdout is not None
    pids = [int(word) for word in tronlab.stdout.readline().split()]
    assert len(pids) == 2
    assert os.getsid(pids[1]) == pids[1]  # Ctrl-C in our terminal does not reach it
    tronlab.kill()
    tronlab.communicate()
    assert [is_gone(pid) for pid in pids] == [True, True]


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        (plain("start=exit3"), "it .*exit code 3; its last words: out of fuel"),
        (plain("start=printing"), r'it wrote "Loading model\.\.\." to standard output, which'),
        (plain("hello=protocol2"), "it speaks version 2 of the core protocol; this .* speaks 1"),
        (plain("hello=other_type"), "it sent a message of type 'ready', expected hello"),
        (plain("hello=stop"), "it is not ready within 0.15 s: it is silent"),
        (CoreSpec("x", "command", "./no_such_program --fast"), "'./no_such_program': No such file"),
        (CoreSpec("x", "command", f"./long {'x' * 5000}"), "'./long': No such file or directory$"),
        (CoreSpec("x", "command", "beside"), r"No such file or directory; write \./beside$"),
        (CoreSpec("x", "command", "./beside"), r"Permission denied; chmod \+x ./beside"),
        (CoreSpec("x", "command", "."), "Permission denied; it is a folder"),
        (CoreSpec("x", "command", "~/core"), "no shell reads this: write the whole path"),
        (CoreSpec("x", "command", "./empty"), "it is no program for this machine, nor a"),
        (CoreSpec("x", "command", "./script"), "it is there, but not what its first line names"),
        (CoreSpec("x", "command", "./a b.py c"), r"put the name in quotes: cmd:'./a b.py'$"),
    ],
)  # fmt: skip
def test_a_core_that_cannot_be_described_is_an_error(
    spec: CoreSpec, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("beside", "empty", "a b.py"):
        Path(name).touch()
    Path("script").write_text("#!/no/such/interpreter\n")
    for name in ("empty", "script"):
        Path(name).chmod(0o755)
    with pytest.raises(ScoreError, match=f"navigation core '{spec.name}': .*{reason}"):
        describe_core(spec, limit_s=0.15 if "stop" in spec.target else 20.0)


def test_a_core_that_cannot_be_set_up_is_a_result(context: CoreContext) -> None:
    with open_core(plain("setup=fail"), context, limit_s=20.0) as core:
        result = core.locate(frame(0))
        assert result.status == "error"
        assert result.reason == "the core cannot work here: not with this lens"
    spec = plain("setup=stop")
    with open_core(spec, context, limit_s=20.0, start_limit_s=0.15) as core:
        assert "the core is not ready within 0.15 s" in core.locate(frame(0)).reason


def test_a_description_changes_with_what_the_answers_depend_on(tmp_path: Path) -> None:
    config = tmp_path / "x.yaml"
    config.write_text("a: 1")
    described = describe_core(plain("--sequential", "--references"))
    assert (described.name, described.version) == ("plain", "7")
    assert (described.is_sequential, described.wants_references) == (True, True)
    one = describe_core(plain(f"--cfg={config}")).identity
    assert describe_core(plain(f"--cfg={config}")).identity == one
    config.write_text("a: 2")
    two = describe_core(plain(f"--cfg={config}")).identity
    assert len({one, two, described.identity}) == 3
