import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from tronlab.campaign.config import NotifyConfig
from tronlab.campaign.notify import Notifier

APPEND = """
import os, sys
with open(sys.argv[1], "a") as file:
    names = ("EVENT", "TEXT", "CAMPAIGN", "DATASET", "SHOTS")
    file.write("|".join(os.environ["TRONLAB_" + name] for name in names) + "\\n")
print("this goes nowhere")
"""


class Told:
    """A notifier whose command runs Python, and everything it says."""

    def __init__(self, *command: str, **settings: Any) -> None:
        self.warnings: list[str] = []
        settings = {"events": ("begun", "suspended", "resumed", "done"), **settings}
        self.notifier = Notifier(
            NotifyConfig.model_validate({"command": command, **settings}),
            campaign="line",
            dataset=Path("/data/dataset.h5"),
            warn=self.warnings.append,
            farewell_s=20.0,
        )

    def tell(self, event: Any, text: str = "", *, n_taken: int = 3) -> None:
        self.notifier.tell(event, text, n_taken=n_taken, n_planned=61)


def python(code: str, *arguments: str) -> tuple[str, ...]:
    return sys.executable, "-I", "-S", "-c", code, *arguments


def test_command_is_told_what_it_wants_to_know_in_order(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told = Told(*python(APPEND, str(tmp_path / "log")))
    with told.notifier:
        told.tell("begun", "61 shots; $HOME `id`", n_taken=0)
        told.tell("failed", "nobody wants to know")
        told.tell("suspended", "door")
        told.tell("done", "fünf", n_taken=61)
    assert (tmp_path / "log").read_text(encoding="utf-8").splitlines() == [
        "begun|61 shots; $HOME `id`|line|/data/dataset.h5|0/61",
        "suspended|door|line|/data/dataset.h5|3/61",
        "done|fünf|line|/data/dataset.h5|61/61",
    ]
    assert told.warnings == []
    assert capfd.readouterr() == ("", "")


def test_event_that_repeats_is_told_once(tmp_path: Path) -> None:
    told = Told(*python(APPEND, str(tmp_path / "log")))
    with told.notifier:
        for _ in range(5):
            told.tell("suspended", "door")
        told.tell("suspended", "beam")
    texts = [line.split("|")[1] for line in (tmp_path / "log").read_text().splitlines()]
    assert texts == ["door", "beam"]


@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        (("/no/such/program",), r"/no/such/program cannot be started: .*No such file"),
        (python("raise SystemExit(3)"), r"ended with exit code 3; the run goes on"),
    ],
)
def test_failure_is_said_once_and_harms_nothing(command: tuple[str, ...], complaint: str) -> None:
    told = Told(*command)
    with told.notifier:
        told.tell("begun")
        told.tell("suspended")
        told.tell("done")
    assert len(told.warnings) == 1
    assert re.search(complaint, told.warnings[0])


def test_text_that_no_environment_can_hold_harms_nothing() -> None:
    told = Told(*python("pass"))
    with told.notifier:
        told.tell("begun", "a\0b")
    assert "cannot be started" in told.warnings[0]


def test_command_that_hangs_is_ended_with_its_children(tmp_path: Path) -> None:
    child = "import time; time.sleep(60)"
    code = (
        "import subprocess, sys\n"
        f"child = subprocess.Popen([sys.executable, '-I', '-S', '-c', {child!r}])\n"
        "open(sys.argv[1], 'w').write(str(child.pid))\n"
        "child.wait()"
    )
    told = Told(*python(code, str(tmp_path / "pid")), timeout_s=1.0)
    with told.notifier:
        told.tell("begun")
    assert "took longer than timeout_s of 1 s and was ended" in told.warnings[0]
    give_up_s = time.monotonic() + 10.0
    while is_alive(int((tmp_path / "pid").read_text())):  # the kernel takes its time to end it
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def is_alive(pid: int) -> bool:
    """Tell whether a process runs: one that is dead may wait for somebody to ask how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_run_never_waits_for_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    may_end = threading.Event()
    threads = set(threading.enumerate())

    class Hanging:
        def __init__(self, *_: object, **__: object) -> None: ...

        def wait(self, timeout: float) -> int:
            may_end.wait(timeout)
            return 0

    monkeypatch.setattr(subprocess, "Popen", Hanging)
    warnings: list[str] = []
    notifier = Notifier(
        NotifyConfig(command=("x",), events=("suspended",)),
        campaign="line",
        dataset=Path("dataset.h5"),
        warn=warnings.append,
        farewell_s=0.01,
    )
    with notifier:
        for i in range(100):
            notifier.tell("suspended", str(i), n_taken=i, n_planned=100)
        assert warnings == [
            "notify.command x is 50 events behind; the run goes on, and this is not said again"
        ]
    may_end.set()
    for thread in set(threading.enumerate()) - threads:
        thread.join(10.0)
        assert not thread.is_alive()


def test_without_a_command_nobody_is_told() -> None:
    threads = set(threading.enumerate())
    with Notifier(None, campaign="line", dataset=Path("d"), warn=pytest.fail) as notifier:
        notifier.tell("done", "", n_taken=1, n_planned=1)
        assert set(threading.enumerate()) <= threads
