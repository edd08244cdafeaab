import io
import re
from typing import cast

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.live import PlainLive, SilentLive, open_live
from tronlab.campaign.live_terminal import TerminalLive
from tronlab.dataset.records import QualityFlag, ShotQuality, ShotRecord, ShotTiming, Truth
from tronlab.devices.readings import Frame


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_plain_lines_come_every_tenth_with_an_eta_learned_from_the_run() -> None:
    stream, clock = io.StringIO(), Clock()
    live = PlainLive(stream, monotonic_s=clock)
    live.announce("begin")
    for n_done in range(41):
        clock.now_s = 2.0 * n_done
        live.advance("shots", n_done=n_done, n_all=40)
    lines = stream.getvalue().splitlines()
    assert lines[:2] == ["begin", "shots: 4 of 40, 72 s left"]
    assert lines[-1] == "shots: 40 of 40, took 80 s"
    assert len(lines) == 11


def test_every_stage_has_its_own_eta() -> None:
    stream, clock = io.StringIO(), Clock()
    live = PlainLive(stream, monotonic_s=clock)
    live.advance("views", n_done=0, n_all=1)
    clock.now_s = 100.0
    live.advance("views", n_done=1, n_all=1)
    live.advance("shots", n_done=0, n_all=2)
    clock.now_s = 101.0
    live.advance("shots", n_done=1, n_all=2)
    assert stream.getvalue().splitlines() == [
        "views: 1 of 1, took 100 s",
        "shots: 1 of 2, 1 s left",
    ]


def test_no_terminal_means_plain_lines() -> None:
    stream = io.StringIO()
    with open_live(stream) as live:
        live.advance("shots", n_done=0, n_all=2)
        live.advance("shots", n_done=2, n_all=2)
    assert re.fullmatch(r"shots: 2 of 2, took 0 s\n", stream.getvalue())


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    @property
    def text(self) -> str:
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.getvalue())


def test_terminal_gets_a_bar_with_counts_and_announcements() -> None:
    stream = Terminal()
    with open_live(stream) as live:
        live.announce("path [1] of it")
        live.advance("shots", n_done=0, n_all=3)
        live.advance("shots", n_done=3, n_all=3)
    assert "path [1] of it" in stream.text
    assert re.search(r"shots\s.*3/3", stream.text)


TIMING = ShotTiming(
    move_s=4.0, settle_s=1.0, tracker_s=1.0, camera_s=0.5, confirm_s=0.5, read_s=0.5, lost_s=0.0
)


def shot(shot_id: int, *flags: QualityFlag) -> ShotRecord:
    quality = ShotQuality(
        settle_shift_m=1e-5,
        settle_turn_rad=1e-5,
        exposure_shift_m=1e-5,
        exposure_turn_rad=1e-5,
        tracker_sigma_m=4.2e-5,
        robot_shift_m=1e-3,
        robot_turn_rad=1e-3,
        saturated_fraction=0.0,
        contrast=0.3,
        sharpness=0.2,
        brightness=None,
        flags=flags,
    )
    pose = RigidTransform.from_translation([0.0, 0.0, 2.0])
    return ShotRecord(
        shot_id=shot_id,
        attempt=1,
        trs_from_cam_nominal=pose,
        robot=None,
        tracker=None,
        room=None,
        frame=Frame(np.zeros((2, 2), np.uint8), "Mono8", 0.01, 0.0, 1, 0.0),
        mask=np.ones((2, 2), np.bool_),
        truth=Truth(pose, np.eye(6), range_los_m=2.0, usable_fraction=0.756),
        quality=quality,
        timing=TIMING,
    )


def screen(live: TerminalLive) -> str:
    console = Console(file=io.StringIO(), width=120)
    console.print(live.picture())
    return cast(io.StringIO, console.file).getvalue()


def terminal_live(clock: Clock) -> TerminalLive:
    return TerminalLive(Console(file=io.StringIO(), width=120), monotonic_s=clock)


def test_terminal_shows_the_last_shots_where_time_goes_and_what_is_left() -> None:
    clock = Clock()
    live = terminal_live(clock)
    live.advance("shots", n_done=0, n_all=100)
    live.expect(dict.fromkeys(range(1, 101), 2.0))
    for shot_id in range(1, 41):
        clock.now_s += 8.0
        live.show_shot(shot(shot_id, *(["blur", "robot"] if shot_id == 39 else [])), write_s=0.5)
        live.advance("shots", n_done=shot_id, n_all=100)
    lines = screen(live).splitlines()
    header = "shot attempt range m usable % sigma mm time s flags"
    assert " ".join(lines[0].split()) == header
    assert [line.split()[0] for line in lines[1:9]] == [str(i) for i in range(33, 41)]
    assert lines[7].endswith("0.042     8.0  blur, robot")
    assert lines[9].startswith("time: motion 160.0 s (50%), settle 40.0 s (12%)")
    assert "40/100" in lines[-1]
    assert "left 0:08:00" in lines[-1]


def test_terminal_shows_the_state_and_since_when() -> None:
    clock = Clock()
    live = terminal_live(clock)
    live.state("suspended: the door is open")
    clock.now_s = 3.0
    live.state("suspended: the door is open")
    clock.now_s = 75.0
    assert "suspended: the door is open, for 0:01:15" in screen(live)
    live.state("running")
    assert "running, for 0:00:00" in screen(live)
    assert "door" not in screen(live)


def test_nothing_is_drawn_while_somebody_is_asked() -> None:
    stream = Terminal()
    with open_live(stream) as live:
        live.advance("shots", n_done=1, n_all=3)
        with live.suspended():
            asked = len(stream.text)
            live.advance("shots", n_done=2, n_all=3)
            live.state("paused")
            assert len(stream.text) == asked
        live.advance("shots", n_done=3, n_all=3)
    assert "3/3" in stream.text[asked:]


def test_drawing_goes_on_after_an_error_while_somebody_is_asked() -> None:
    stream = Terminal()
    with open_live(stream) as live:
        with pytest.raises(KeyError), live.suspended():
            raise KeyError
        live.announce("still here")
        live.advance("shots", n_done=1, n_all=1)
    assert "still here" in stream.text
    assert "1/1" in stream.text


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_where_time_went_is_said_however_the_run_ends(stream: io.StringIO) -> None:
    def run() -> None:
        with open_live(stream) as live:
            live.show_shot(shot(1), write_s=0.5)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    text = re.sub(r"\s+", " ", stream.getvalue())
    assert "shots taken: 1; their time: motion 4.0 s (50%), settle 1.0 s (12%)" in text


def test_plain_lines_name_what_is_flagged() -> None:
    stream, clock = io.StringIO(), Clock()
    live = PlainLive(stream, monotonic_s=clock)
    for shot_id in (1, 2):
        clock.now_s += 8.0
        live.show_shot(shot(shot_id, *(["blur"] if shot_id == 2 else [])), write_s=0.5)
        live.advance("shots", n_done=shot_id, n_all=20)
    with live.suspended():
        live.state("paused")
    assert stream.getvalue().splitlines() == ["shot 2: flagged: blur", "shots: 2 of 20, 144 s left"]


def test_silence() -> None:
    live = SilentLive()
    live.announce("nothing")
    live.advance("nothing", n_done=0, n_all=0)
    live.expect({})
    live.show_shot(shot(1), write_s=0.0)
    live.state("nothing")
    with live.suspended():
        pass
