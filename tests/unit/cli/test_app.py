import subprocess
import sys

import pytest
import typer

from tronlab.cli import app as cli_app
from tronlab.errors import ConfigError, NotConnectedError

HEAVY = ("cv2", "numba", "pandas", "matplotlib", "bluesky", "scipy", "h5py", "numpy")


def run(*arguments):
    command = [sys.executable, "-c", "from tronlab.cli import main; main()", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def fail_with(monkeypatch, error):
    def raise_it():
        raise error

    monkeypatch.setattr(cli_app, "app", raise_it)


def test_help_lists_every_command():
    result = run("--help")
    assert result.returncode == 0
    for command in ("demo", "plan", "run", "score", "report", "calibrate", "budget", "dataset"):
        assert command in result.stdout


def test_help_imports_nothing_heavy():
    code = "import sys, tronlab.cli; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not set(HEAVY) & set(loaded)


def test_the_version_is_told():
    assert run("--version").stdout.startswith("tronlab 0.")


def test_an_unknown_command_is_no_traceback():
    result = run("rn")
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def test_a_users_mistake_is_one_message_and_exit_code_2(monkeypatch, capsys):
    fail_with(monkeypatch, ConfigError("not a number", path="a.yaml", line=6, key="seed"))
    with pytest.raises(SystemExit) as caught:
        cli_app.main()
    assert caught.value.code == 2
    assert capsys.readouterr().err == "error: a.yaml:6: seed: not a number\n"


def test_all_devices_that_failed_are_told(monkeypatch, capsys):
    errors = [NotConnectedError("no answer", device=name) for name in ("robot", "camera")]
    fail_with(monkeypatch, ExceptionGroup("2 of 5 devices failed to connect", errors))
    with pytest.raises(SystemExit) as caught:
        cli_app.main()
    assert caught.value.code == 2
    assert capsys.readouterr().err == "error: robot: no answer\nerror: camera: no answer\n"


def test_our_own_mistake_keeps_its_traceback(monkeypatch):
    fail_with(monkeypatch, ExceptionGroup("mixed", [ValueError("ours")]))
    with pytest.raises(ExceptionGroup):
        cli_app.main()


def test_ctrl_c_is_exit_code_130(monkeypatch):
    fail_with(monkeypatch, KeyboardInterrupt())
    with pytest.raises(SystemExit) as caught:
        cli_app.main()
    assert caught.value.code == 130


def test_ctrl_c_inside_a_command_is_told(monkeypatch, capsys):
    def interrupted():
        raise KeyboardInterrupt

    app = typer.Typer()
    app.command()(interrupted)
    monkeypatch.setattr(cli_app, "app", app)
    monkeypatch.setattr(sys, "argv", ["tronlab"])
    with pytest.raises(SystemExit) as caught:
        cli_app.main()
    assert caught.value.code == 130
    assert "interrupted" in capsys.readouterr().err
