"""Python cores in a process of their own: nothing is lost on the way, nothing they print hurts."""

import importlib
import subprocess
import sys
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plain_cores import CAMERA, frame, reference
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext, NavigationResult, PosePrior
from tronlab.nav.foreign import ForeignCore, describe_core, host
from tronlab.nav.foreign.channel import Ends
from tronlab.nav.foreign.host import _build, _says_it_is_sequential
from tronlab.nav.foreign.identity import digest_of_sources
from tronlab.nav.foreign.installed import Factory, load_core
from tronlab.nav.specs import CoreSpec, parse_core

HOSTED = '''
    import os
    import sys

    import numpy as np
    from scipy.spatial.transform import RigidTransform, Rotation

    from tronlab.nav.core import CoreContext, Frame, NavigationResult

    print("Loading model...")
    os.write(1, b"from C, perhaps")
    __version__ = "3.1"


    class Hosted:
        name = "hosted"

        def __init__(self, context: CoreContext) -> None:
            if context.settings.get("gain") == 0:
                raise ValueError("a gain of 0 sees nothing")
            self.context = context
            self.kept = []
            self.n = 0

        def reset(self) -> None:
            self.n = 0

        def locate(self, frame: Frame) -> NavigationResult:
            print("looking at", frame.number)
            assert sys.stdin.read() == ""
            if frame.number == 1:
                raise RuntimeError("lost at sea")
            if frame.number == 2:
                return "a pose"
            if frame.number == 3:
                return NavigationResult("no_pose", reason="dark")
            self.n += 1
            self.kept.append(frame)
            view = self.context.references[-1]
            prior = frame.prior
            return NavigationResult(
                "ok",
                view.trs_from_cam if prior is None else prior.trs_from_cam,
                covariance=None if prior is None else prior.covariance,
                bound=np.eye(6) * float(np.nansum(view.depth_m)),
                n_features=int(self.kept[0].image.sum()),
                n_matches=int(frame.mask.sum()) + int(view.mask.sum()),
                n_inliers=self.n,
                uv_inliers=np.arange(2.0 * self.n).reshape(-1, 2) / 3,
                landmark_inliers=np.arange(self.n) + 2**40,
                database="d" * 8,
                time_pose_s=frame.time_s,
                reason=f"{self.context.settings} {self.context.seed} {self.context.camera}",
            )


    def make(context: CoreContext) -> Hosted:
        return Hosted(context)


    def unsaid(context):
        return Hosted(context)


    def useless(context):
        return 3


    not_callable = 3
'''  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hosted")
    (folder / "hosted_core.py").write_text(textwrap.dedent(HOSTED))
    return folder


@pytest.fixture(autouse=True)
def importable(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder)


def test_a_hosted_class_gets_and_gives_everything(
    opened: Callable[..., ForeignCore], folder: Path
) -> None:
    settings = {"gain": 2.5, "names": ["a", {"b": None}]}
    core = opened(CoreSpec("hosted", "python", "hosted_core:Hosted", settings, seed=11))
    pose = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([0.1, 2.0, 0.3]))
    prior = PosePrior(pose, np.diag([1e-6, 2e-6, 3e-6, 4.0, 5.0, 1 / 3]))
    view = reference(9)
    first, second = (
        core.locate(frame(0, time_s=1.5)),
        core.locate(frame(4, time_s=2.0, prior=prior)),
    )
    for n, result in enumerate((first, second), start=1):
        assert result.status == "ok", result.reason
        assert result.reason == f"{settings} 11 {CAMERA}"
        assert result.n_features == frame(0).image.sum()  # its first frame, which it kept
        assert (result.n_inliers, result.database) == (n, "d" * 8)
        assert result.n_matches == frame(0).mask.sum() + view.mask.sum()
        np.testing.assert_array_equal(result.uv_inliers, np.arange(2.0 * n).reshape(-1, 2) / 3)
        np.testing.assert_array_equal(result.landmark_inliers, np.arange(n) + 2**40)
        assert result.bound is not None
        np.testing.assert_array_equal(result.bound, np.eye(6) * np.nansum(view.depth_m))
    for result, expected in ((first, view.trs_from_cam), (second, pose)):
        assert result.trs_from_cam is not None
        difference = result.trs_from_cam.as_matrix() - expected.as_matrix()
        assert np.abs(difference).max() < 1e-15
    assert first.time_pose_s == 1.5
    assert first.covariance is None
    np.testing.assert_array_equal(second.covariance, prior.covariance)
    reasons = [(core.locate(frame(n)).status, core.locate(frame(n)).reason) for n in (1, 2, 3)]
    assert reasons == [
        ("error", "RuntimeError: lost at sea"),
        ("error", "TypeError: the core answered a str, not a NavigationResult"),
        ("no_pose", "dark"),
    ]
    core.reset()
    assert core.locate(frame(5, time_s=3.0)).n_inliers == 1


def test_the_identity_changes_with_the_sources_side_by_side(folder: Path) -> None:
    beside = folder / "helper_of_hosted.py"
    beside.write_text("n = 1")
    importlib.import_module("helper_of_hosted")
    load_core("hosted_core:Hosted")
    before = digest_of_sources("hosted_core")
    assert digest_of_sources("hosted_core") == before
    beside.write_text("n = 2")
    assert digest_of_sources("hosted_core") != before


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("hosted_core:Missing", "hosted_core:Missing cannot be imported: AttributeError"),
        ("hosted_core:not_callable", "is a int, must be a class or a factory"),
        ("no_such_module:Core", "cannot be imported: ModuleNotFoundError: No module named"),
    ],
)
def test_what_cannot_be_loaded_says_why(target: str, reason: str) -> None:
    with pytest.raises(ScoreError, match=reason):
        load_core(target)


def test_the_reason_is_the_last_thing_the_host_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "_take_standard_streams", lambda: Ends(0, 1))
    with pytest.raises(SystemExit, match="no_such:Core cannot be imported: ModuleNotFoundError"):
        host.main(["no_such:Core", "--listen", "127.0.0.1:0"])
    for address in ("127.0.0.1", "127.0.0.1:99999", ":x"):
        with pytest.raises(SystemExit, match=f"--listen {address}: write HOST:PORT"):
            host.main(["hosted_core:Hosted", "--listen", address])


def test_state_is_known_by_the_class_or_said_by_the_factory(context: CoreContext) -> None:
    def factory(name: str) -> Factory:
        return load_core(f"hosted_core:{name}").factory

    assert [_says_it_is_sequential(factory(name)) for name in ("Hosted", "make", "unsaid")] == [
        True,
        True,
        False,
    ]
    with pytest.raises(ScoreError, match="write '-> Hosted' behind the factory's arguments"):
        _build(factory("unsaid"), context)
    with pytest.raises(ScoreError, match=r"it made a int, which has no method locate\(frame\)"):
        _build(factory("useless"), context)


def test_a_listening_host_serves_one_after_the_other(
    opened: Callable[..., ForeignCore], folder: Path
) -> None:
    command = [sys.executable, "-m", "tronlab.nav.foreign.host", "hosted_core:Hosted"]
    listener = subprocess.Popen(
        [*command, "--listen", "127.0.0.1:0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
    )
    try:
        assert listener.stdout is not None
        spec = parse_core(listener.stdout.readline().strip())
        described = describe_core(spec)
        assert (described.version, described.is_sequential, described.wants_references) == (
            "3.1",
            True,
            True,
        )
        for _ in range(2):
            core = opened(spec)
            result: NavigationResult = core.locate(frame(0, time_s=0.25))
            assert (result.status, result.n_inliers) == ("ok", 1), result.reason
            core.close()
        refused = opened(replace(spec, settings={"gain": 0})).locate(frame(0))
        assert (refused.status, refused.reason) == (
            "error",
            "the core cannot work here: ValueError: a gain of 0 sees nothing",
        )
    finally:
        listener.kill()
        listener.communicate()
