import io
import os
import threading
from collections.abc import Generator
from contextlib import contextmanager

import pytest

from tronlab.campaign.console import Abort, Note, Pause, Resume, Retake, TerminalConsole
from tronlab.campaign.suspension import Suspension

PAUSE = Pause(committed={1, 2, 12}, skipped={3: "tracker: beam broken"}, n_left=8, n_retakes_left=2)


def answer(text: str, pause: Pause = PAUSE) -> tuple[object, str]:
    """Type something; give the decision and what the terminal shows."""
    shown = io.StringIO()
    return TerminalConsole(io.StringIO(text), shown).ask(pause), shown.getvalue()


@pytest.mark.parametrize(
    ("text", "decision"),
    [
        ("r\n", Resume()),
        ("resume\n", Resume()),
        ("  R \n", Resume()),
        ("a\n", Abort()),
        ("abort\n", Abort()),
        ("t 12\n", Retake((12,))),
        ("t 2, 12,2\n", Retake((2, 12))),
        ("take 3\n", Retake((3,))),
        ("n lamp  housing touched\n", Note("lamp  housing touched")),
        ("", Abort()),
    ],
)
def test_answers(text: str, decision: object) -> None:
    assert answer(text)[0] == decision


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n", "'' is none of: r)esume"),
        ("q\n", "'q' is none of: r)esume, t)ake again SHOTS, n)ote TEXT, a)bort"),
        ("t\n", "t: '' are no shots; expected their numbers, such as: t 12 13"),
        ("t 1 two\n", "t: '1 two' are no shots"),
        ("t -1\n", "t: '-1' are no shots"),
        ("t 1 4 5\n", "t: shots not taken yet in this session: 4, 5; only those stored or"),
        ("t 1 2 12\n", "t: the dataset has room for 2 shots to be taken again, not 3; after the"),
        ("n  \n", "n: the text is missing"),
    ],
)
def test_what_makes_no_sense_is_asked_again(text: str, message: str) -> None:
    decision, shown = answer(text + "r\n")
    assert decision == Resume()
    assert message in shown
    assert shown.count("> ") == 2


def test_it_shows_how_the_run_stands() -> None:
    _, shown = answer("r\n")
    assert shown.splitlines()[0] == "paused: 3 shots are stored, 8 to come; skipped: 3"
    waiting = Pause({1}, {}, 2, suspension=Suspension("shot 2", "beam", "tracker: no beam"))
    assert "waiting before shot 2: tracker: no beam" in answer("r\n", waiting)[1]


def test_nobody_writes_between_question_and_answer() -> None:
    shown = io.StringIO()

    @contextmanager
    def undisturbed() -> Generator[None]:
        shown.write("[")
        yield
        shown.write("]")

    TerminalConsole(io.StringIO("x\nr\n"), shown, undisturbed=undisturbed).ask(PAUSE)
    assert (shown.getvalue()[0], shown.getvalue()[-1]) == ("[", "]")
    assert shown.getvalue().count("[") == 1


@pytest.fixture
def pipe() -> Generator[tuple[io.TextIOWrapper, int]]:
    read_fd, write_fd = os.pipe()
    with open(read_fd, encoding="utf-8") as stdin:
        yield stdin, write_fd
    os.close(write_fd)


def test_lines_that_came_at_once_are_answers_in_turn(pipe: tuple[io.TextIOWrapper, int]) -> None:
    stdin, write_fd = pipe
    console = TerminalConsole(stdin, io.StringIO())
    os.write(write_fd, "n über\na".encode())
    assert console.ask(PAUSE) == Note("über")
    os.write(write_fd, b"\n")
    assert console.ask(PAUSE) == Abort()


def test_a_question_can_be_dismissed(pipe: tuple[io.TextIOWrapper, int]) -> None:
    console = TerminalConsole(pipe[0], io.StringIO())
    decisions: list[object] = []
    thread = threading.Thread(target=lambda: decisions.append(console.ask(PAUSE)))
    thread.start()
    console.dismiss()
    thread.join(timeout=10)
    assert decisions == [Abort()]
