"""A stand-in for Blender's Python, which crashes, is slow and answers nonsense on request."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.cycles import process, scene
from tronlab.render.cycles.process import PYTHON_VARIABLE, BlenderProcess, blender_python
from tronlab.render.cycles.renderer import open_cycles
from tronlab.render.renderer import Lamp, RenderError
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

FLAT = HeightMap(np.zeros((5, 7), np.float32), 0.1, np.zeros(3))
PINHOLE = CameraModel(8, 6, 10.0, 10.0, 3.5, 2.5)
DOWN = pose_along_boresight([0.2, 0.3, 1.0], boresight=[0, 0, -1], right=[0, 1, 0])
LAMP = Lamp(np.array([0.0, 0.0, 2.0]), 3.0)

STAND_IN = """
import json, os, shutil, sys, threading, time
import numpy as np

folder = sys.argv[-1]
print("Blender says hello", file=sys.stderr, flush=True)
{at_start}

def answer(what):
    try:
        print(json.dumps(what), flush=True)
    except BrokenPipeError:
        shutil.rmtree(folder)
        os._exit(0)

answer({{"blender": "stand-in"}})
for line in sys.stdin:
    request = json.loads(line)
    if request["do"] == "wait":
        time.sleep(1)
    if request["do"] == "render":
        {at_render}
        camera = request["camera"]
        shape = camera["height_px"], camera["width_px"]
        up = np.zeros((*shape, 3), np.float32)
        up[..., 2] = 1
        np.savez(
            os.path.join(folder, request["image"]),
            radiance=np.full(shape, 0.25, np.float32),
            depth_m=np.ones(shape, np.float32),
            facet_normal=up,
            slope=np.zeros((*shape, 2), np.float32),
            albedo=np.ones(shape, np.float32),
        )
    answer({{}})
shutil.rmtree(folder)
"""

StandIn = Callable[..., Path]


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """Put a stand-in in Blender's place."""

    def make(*, at_start: str = "", at_render: str = "pass") -> Path:
        python = tmp_path / "python"
        script = textwrap.dedent(STAND_IN).format(at_start=at_start, at_render=at_render)
        python.write_text(f"#!{sys.executable}\n{script}")
        python.chmod(0o755)
        monkeypatch.setenv(PYTHON_VARIABLE, str(python))
        return python

    return make


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until_gone(pid: int) -> None:
    deadline = time.monotonic() + 20
    while is_running(pid):
        assert time.monotonic() < deadline, "it is still running"
        time.sleep(0.02)


def test_an_image_is_put_together(stand_in: StandIn) -> None:
    stand_in()
    said: list[str] = []
    renderer = open_cycles(FLAT, announce=said.append)
    settings = RenderSettings(ambient=0.1, vignetting_power=4)
    first, second = renderer.render_batch(PINHOLE, [DOWN, DOWN], LAMP, settings)
    cos_off_axis = (1 + 2 * 0.05**2) ** -0.5
    radiance = 3.0 * (0.25 + 0.1) * cos_off_axis**4
    assert first.radiance[2, 3] == pytest.approx(radiance, rel=1e-6)
    np.testing.assert_allclose(first.points_trs_m[2, 3], [0.15, 0.25, 0.0], atol=1e-6)
    assert first.is_lit.all()
    np.testing.assert_array_equal(first.radiance, second.radiance)
    assert said == ["starting Blender with 35 samples of terrain (0.4 GB)"]
    renderer.close()


def test_a_crash_is_told_with_its_last_words_and_the_next_image_starts_anew(
    stand_in: StandIn, tmp_path: Path
) -> None:
    flag = tmp_path / "crashed"
    stand_in(
        at_render=f"""
        if not os.path.exists({str(flag)!r}):
            open({str(flag)!r}, "w").close()
            print("no such thing as a free lunch", file=sys.stderr, flush=True)
            os._exit(7)
"""
    )
    renderer = open_cycles(FLAT)
    with pytest.raises(RenderError) as raised:
        renderer.render(PINHOLE, DOWN, LAMP)
    assert str(raised.value) == (
        "renderer cycles: Blender ended (exit code 7) when it should render an image\n"
        "its last words:\n  Blender says hello\n  no such thing as a free lunch"
    )
    assert renderer.render(PINHOLE, DOWN, LAMP).is_lit.all()
    renderer.close()


@pytest.mark.parametrize(
    ("at_render", "message"),
    [
        ("os.kill(os.getpid(), 9)", r"Blender ended \(signal 9\) when it should render"),
        ("print('Fra:1 Mem:12M', flush=True)", r"answered 'Fra:1 Mem:12M' when it should render"),
        ("answer([1, 2])", r"answered '\[1, 2\]' when it should render"),
        ("answer({'error': 'no lamp'}); continue", r"could not render an image: no lamp"),
        ("time.sleep(60)", r"did not render an image within 0.2 s"),
        ("request['image'] = 'elsewhere.npz'", r"wrote no image that can be read"),
    ],
    ids=["killed", "chatter", "no object", "error", "slow", "no file"],
)
def test_what_goes_wrong_in_blender(
    stand_in: StandIn, monkeypatch: pytest.MonkeyPatch, at_render: str, message: str
) -> None:
    monkeypatch.setattr(scene, "IMAGE_LIMIT_S", 0.2 if "sleep" in at_render else 60.0)
    monkeypatch.setattr(process, "_END_LIMIT_S", 0.2)
    stand_in(at_render=at_render)
    renderer = open_cycles(FLAT)
    with pytest.raises(RenderError, match=message):
        renderer.render(PINHOLE, DOWN, LAMP)
    renderer.close()


def test_a_python_without_blender(stand_in: StandIn) -> None:
    stand_in(at_start="import bpy")
    with pytest.raises(
        RenderError, match=r"(?s)ended \(exit code 1\).*No module.*pip install 'bpy"
    ):
        open_cycles(FLAT).render(PINHOLE, DOWN, LAMP)


def test_a_python_that_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "python").write_text("")
    monkeypatch.setenv(PYTHON_VARIABLE, str(tmp_path / "python"))
    with pytest.raises(RenderError, match=r"python does not start: .*denied"):
        open_cycles(FLAT).render(PINHOLE, DOWN, LAMP)


def test_where_blender_is_not_there_the_error_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PYTHON_VARIABLE, str(tmp_path / "none"))
    with pytest.raises(RenderError, match=rf"{PYTHON_VARIABLE} is .*none\n(?s:.*)pip install 'bpy"):
        open_cycles(FLAT)
    monkeypatch.delenv(PYTHON_VARIABLE)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with pytest.raises(RenderError, match=r"looked for at .*tronlab/blender/bin/python"):
        open_cycles(FLAT)
    python = tmp_path / "tronlab" / "blender" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.touch()
    assert blender_python() == python


def test_who_asks_after_the_end_is_told(stand_in: StandIn) -> None:
    blender = BlenderProcess(stand_in(at_render="os._exit(7)"))
    for message in (r"exit code 7\).*last words", r"ended \(exit code 7\) when it should blend$"):
        with pytest.raises(RenderError, match=rf"(?s){message}"):
            blender.ask({"do": "render"}, what="blend", limit_s=10)
    assert blender.has_ended


@pytest.mark.parametrize("signal_", [signal.SIGKILL, signal.SIGINT])
def test_no_blender_and_no_files_outlive_us(
    stand_in: StandIn, tmp_path: Path, signal_: signal.Signals
) -> None:
    stand_in()
    program = f"""
        import os, signal, sys, tempfile
        # A shell that starts tests in the background has them ignore Ctrl-C.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        tempfile.tempdir = {str(tmp_path)!r}
        from tronlab.render.cycles.process import BlenderProcess
        from pathlib import Path
        blender = BlenderProcess(Path(os.environ[{PYTHON_VARIABLE!r}]))
        print(blender._process.pid, flush=True)
        blender.ask({{"do": "wait"}}, what="wait", limit_s=600)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.send_signal(signal_)
    wait_until_gone(pid)
    assert not list(tmp_path.glob("tronlab-blender-*"))


def test_a_terrain_too_large_for_memory(stand_in: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in()
    monkeypatch.setattr("tronlab.render.memory.available_bytes", lambda: 10_000_000_000)
    half_the_model = np.broadcast_to(np.float32(0), (4400, 8400))
    with pytest.raises(
        RenderError, match=r"36,960,000 samples .* needs about 19.\d GB.*\n.*every_n: 2"
    ):
        open_cycles(HeightMap(half_the_model, 5e-4, np.zeros(3)))


def test_what_cycles_cannot_do(stand_in: StandIn) -> None:
    stand_in()
    renderer = open_cycles(FLAT)
    with pytest.raises(RenderError, match=r"photometry is 'hapke', must be 'lambert'"):
        renderer.render(PINHOLE, DOWN, LAMP, RenderSettings.model_validate({"photometry": "hapke"}))
    with pytest.raises(RenderError, match=r"lamp: radius_m is -1"):
        renderer.render(PINHOLE, DOWN, Lamp(np.zeros(3), 1.0, radius_m=-1.0))
