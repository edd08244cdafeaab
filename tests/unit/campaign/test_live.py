import io
import re

from tronlab.campaign.live import PlainLive, SilentLive, open_live


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


def test_terminal_gets_a_bar_with_counts_and_announcements() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with open_live(stream) as live:
        live.announce("path [1] of it")
        live.advance("shots", n_done=0, n_all=3)
        live.advance("shots", n_done=3, n_all=3)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", stream.getvalue())
    assert "path [1] of it" in text
    assert re.search(r"shots\s.*3/3", text)


def test_silence() -> None:
    live = SilentLive()
    live.announce("nothing")
    live.advance("nothing", n_done=0, n_all=0)
