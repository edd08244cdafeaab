"""The example cores, and the C header they are written with, against a peer of their own."""

import json
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from core_peer import RESET, Peer, frame, hello, message, part, setup
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import CoreContext, Frame, NavigationResult, PosePrior
from tronlab.nav.foreign import describe_core, open_core
from tronlab.nav.specs import parse_core

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples/cores"
STRICT = "-Wall -Wextra -Wpedantic -Werror"
SANITIZERS = "-fsanitize=address,undefined -fno-sanitize-recover=all"
SMALL = CameraModel(32, 24, 25.0, 25.0, 15.6, 11.5, (-0.1, 0.02, 1e-4, 2e-4, 0.0, 0.01, 0.0, 0.5))
LENS = CameraModel(160, 144, 125.0, 125.5, 79.0, 72.3, (-0.11, 0.04, 4e-4, -3e-4))


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The cores, compiled without a warning; with sanitizers where the compiler has them."""
    if not (shutil.which("cc") and shutil.which("c++")):
        pytest.skip("no C and C++ compiler")
    folder = tmp_path_factory.mktemp("cores")
    echo, checks = folder / "echo", SANITIZERS
    command = f"cc -std=c99 {STRICT} -I{EXAMPLES} {ROOT}/tests/support/echoing_core.c -lm -o {echo}"
    if subprocess.run([*command.split(), *checks.split()], check=False).returncode:
        checks = "-O1"
        subprocess.run([*command.split(), checks], check=True)
    # As their README says, by the Makefile; the C++ library checks its indices.
    programs_left = shutil.ignore_patterns("nearest_view", "track_prior")
    made = shutil.copytree(EXAMPLES, folder / "made", ignore=programs_left)
    flags = [f"CFLAGS={STRICT} {checks}", f"CXXFLAGS=-O1 {STRICT} -D_GLIBCXX_ASSERTIONS"]
    built = subprocess.run(
        ["make", "-sj2", "-C", made, *flags], capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    return {"echo": echo} | {name: made / name for name in ("nearest_view", "track_prior")}


@pytest.fixture(scope="session")
def views() -> tuple[ReferenceView, ...]:
    rng = np.random.default_rng(7)
    shape = SMALL.shape
    return tuple(
        ReferenceView(
            i,
            RigidTransform.from_components([i, 2, 3], Rotation.from_rotvec([0.1 * i, 2, 0])),
            rng.integers(0, 256, shape, np.uint8),
            rng.uniform(1, 2, shape).astype(np.float32),
            rng.random(shape) < 0.9,
        )
        for i in range(3)
    )


@pytest.fixture
def image() -> NDArray[np.uint16]:
    return np.random.default_rng(8).integers(0, 4096, SMALL.shape, np.uint16)


ALL = np.ones(SMALL.shape, np.bool_)


# --- what a core is told


def test_everything_that_is_told_arrives(
    programs: dict[str, Path], views: tuple[ReferenceView, ...], image: NDArray[np.uint16]
) -> None:
    mask = np.random.default_rng(9).random(SMALL.shape) < 0.5
    covariance = np.random.default_rng(9).normal(size=(6, 6))
    prior = views[1].trs_from_cam
    with Peer(programs["echo"]) as peer:
        assert peer.ask(hello({"text": "ab", "number": -1.25e-3}, seed=2**53))[0] == {
            "type": "hello",
            "protocol": 1,
            "name": "echo",
            "version": "2.5",
            "identity": "build 7",
            "sequential": False,
            "references": True,
            "shared_memory": True,
        }
        assert peer.ask(setup(SMALL, views))[0] == {"type": "ready"}
        said, payload = peer.ask(
            frame(41, image, mask, time_s=1.7e9 + 0.125, prior=(prior, covariance))
        )
        (uv,) = said.pop("parts")
        assert uv == {
            "name": "uv_inliers",
            "dtype": "f8",
            "shape": [5, 2],
            "offset": 0,
            "where": "payload",
        }
        depth = float(views[-1].depth_m[-1, -1])
        assert np.frombuffer(payload, "<f8").tolist() == [
            *(1.7e9 + 0.125, 2.0**53, image[0, 0], image[-1, -1], depth, -1.25e-3, 0.5),
            *(ord("a"), ord("b"), 0.0),
        ]
        pose = said.pop("pose")
        assert (pose["parent"], pose["child"]) == ("trs", "cam")
        assert pose["position_m"] == prior.translation.tolist()
        assert pose["quaternion_xyzw"] == prior.rotation.as_quat().tolist()
        assert said.pop("covariance") == covariance.ravel().tolist()
        assert said == {
            "type": "result",
            "number": 41,
            "status": "ok",
            "n_features": mask.sum(),
            "n_matches": 3,
            "n_inliers": 5,
            "time_detect_s": 0,
            "time_match_s": 0,
            "time_pose_s": 0,
            "reason": 'a "quoted" \\ reason\n??',
        }
        # Nothing is offered, and 8 bit.
        said, payload = peer.ask(frame(42, views[0].image, mask))
        assert (said["status"], said["number"], "pose" in said) == ("no_pose", 42, False)
        assert np.isnan(np.frombuffer(payload, "<f8")[0])
        assert np.frombuffer(payload, "<f8")[3] == views[0].image[-1, -1]
        peer.send(RESET)  # which this core has no use for
        code, complaints = peer.end()
    assert code == 0
    assert complaints == "this would break the messages if it got between them\n"


def test_a_frame_may_come_in_shared_memory(
    programs: dict[str, Path],
    views: tuple[ReferenceView, ...],
    image: NDArray[np.uint16],
    tmp_path: Path,
) -> None:
    mask = ALL.view(np.uint8)
    memory = tmp_path / "frame"
    offset = -(-image.nbytes // 8) * 8
    memory.write_bytes(image.tobytes().ljust(offset, b"\0") + mask.tobytes())
    shared = {"path": str(memory), "size": memory.stat().st_size}
    parts = [part("image", image, 0, "shared_memory"), part("mask", mask, offset, "shared_memory")]
    header = {"type": "frame", "number": 0, "time_s": None, "prior": None}
    with Peer(programs["echo"]) as peer:
        peer.ask(hello())
        assert peer.ask(setup(SMALL, views, shared))[0] == {"type": "ready"}
        memory.unlink()
        said, payload = peer.ask(message(header, shared=parts))
        assert said["n_features"] == ALL.sum()
        assert np.frombuffer(payload, "<f8")[2:4].tolist() == [image[0, 0], image[-1, -1]]
        # The payload still does, and a part beyond the memory is refused.
        assert peer.ask(frame(1, image, ALL))[0]["number"] == 1
        parts[1]["offset"] = offset + 8
        code, complaints = peer.end(message(header, shared=parts))
    assert (code, "mask of the camera's size" in complaints) == (2, True)


def test_a_failed_setup_and_a_pose_that_is_not_finite_are_told(
    programs: dict[str, Path], views: tuple[ReferenceView, ...], image: NDArray[np.uint16]
) -> None:
    with Peer(programs["echo"]) as peer:
        peer.ask(hello({"fail": "no such camera"}))
        assert peer.ask(setup(SMALL, views))[0] == {"type": "failed", "reason": "no such camera"}
        peer.ask(hello({"nan": True}))
        assert peer.ask(setup(SMALL, views))[0] == {"type": "ready"}
        prior = (views[0].trs_from_cam, np.eye(6))
        said, _ = peer.ask(frame(0, image, ALL, prior=prior))
        assert said["pose"]["position_m"] == [0, None, 3]


# --- the JSON of the header, and bytes that are none

TEXTS = st.text(
    st.sampled_from('ab{}[],:"\\/\b\f\n\r\t\x01\x7f 0-.eé\u07ff€\uffff😀\U0010ffff'), max_size=20
)
LEAVES = st.none() | st.booleans() | st.floats(allow_nan=False, allow_infinity=False) | TEXTS
NESTED = st.lists(LEAVES, max_size=2) | st.dictionaries(TEXTS, LEAVES, max_size=2)
NOISE = LEAVES | st.lists(NESTED, max_size=2) | st.dictionaries(TEXTS, NESTED, max_size=2)


@pytest.fixture(scope="session")
def echo(programs: dict[str, Path]) -> Iterator[tuple[str, int]]:
    """The address of a listening core, which must still be alive when all tests are done."""
    process = subprocess.Popen(
        [programs["echo"], "--listen", "0"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    assert process.stderr is not None
    (found,) = re.findall(r"^listening on 127\.0\.0\.1:(\d+)$", process.stderr.readline())
    # What it complains of, hundreds of times, must not fill the pipe.
    drain = subprocess.Popen(["cat"], stdin=process.stderr, stdout=subprocess.DEVNULL)
    yield "127.0.0.1", int(found)
    assert process.poll() is None
    process.kill()
    process.wait()
    process.stderr.close()
    drain.wait()


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    before=st.dictionaries(TEXTS, NOISE, max_size=3),
    after=st.dictionaries(TEXTS, NOISE, max_size=3),
    text=TEXTS,
    number=st.floats(allow_nan=False, allow_infinity=False),
    is_ascii=st.booleans(),
    indent=st.sampled_from([None, 1]),
)
def test_values_are_found_whatever_stands_around_them(
    echo: tuple[str, int],
    image: NDArray[np.uint16],
    before: dict[str, Any],
    after: dict[str, Any],
    text: str,
    number: float,
    is_ascii: bool,
    indent: int | None,
) -> None:
    named = {"text": text, "number": number}
    around = {key: value for key, value in (before | after).items() if key not in {"fail", "nan"}}
    told = {"type": "hello", "protocol": 1, "settings": {**around, **named, **after, **named}}
    header = json.dumps(told, ensure_ascii=is_ascii, indent=indent).encode()
    with Peer(address=echo) as peer:
        peer.ask(b"TLC1" + len(header).to_bytes(4, "little") + bytes(8) + header)
        peer.ask(setup(SMALL, ()))
        _, payload = peer.ask(frame(0, image, ALL))
    values = np.frombuffer(payload, "<f8")[5:]
    assert values[0] == number
    assert bytes(values[2:].astype(np.uint8)).rstrip(b"\0") == text.encode()


def conversation(views: Sequence[ReferenceView], image: NDArray[np.uint16]) -> bytes:
    told = hello({"text": "a\né", "number": 1.5, "list": [1, {"a": None}]})
    prior = (views[0].trs_from_cam, np.eye(6))
    return told + setup(SMALL, views) + frame(0, image, ALL, time_s=1.0, prior=prior)


def mutants(whole: bytes, n: int) -> Iterator[bytes]:
    """Give damaged conversations: cut, with bytes changed where lengths and headers are, random."""
    rng = np.random.default_rng(20261122)
    starts = [found.start() for found in re.finditer(b"TLC1", whole)]
    for i in range(n):
        start = int(rng.choice(starts))
        damaged = bytearray(whole)
        if i % 4 == 0:
            damaged = damaged[: rng.integers(len(whole))]
        elif i % 4 == 1:
            damaged[start + rng.integers(4, 16)] = rng.integers(256)
        elif i % 4 == 2:
            for at in start + 16 + rng.integers(0, 400, rng.integers(1, 4)):
                damaged[min(at, len(whole) - 1)] = rng.choice(list(b'09-.eE+{}[]",:\\u\0\x80 a'))
        else:
            damaged[start:] = rng.bytes(rng.integers(0, 200))
        yield bytes(damaged)


def test_garbage_neither_harms_nor_blocks_a_core(
    echo: tuple[str, int], views: tuple[ReferenceView, ...], image: NDArray[np.uint16]
) -> None:
    whole = conversation(views, image)
    for damaged in mutants(whole, 400):
        with socket.create_connection(echo, timeout=20) as link:
            try:
                link.sendall(damaged)
                link.shutdown(socket.SHUT_WR)
                while link.recv(1 << 16):
                    pass
            except OSError:
                pass  # it hung up before it had read everything
    with Peer(address=echo) as peer:
        peer.ask(hello())
        peer.ask(setup(SMALL, views))
        assert peer.ask(frame(5, image, ALL))[0]["number"] == 5


@pytest.mark.parametrize(
    ("sent", "complaint"),
    [
        (b"", ""),
        (b"TLC", "the stream ended within a message"),
        (b"Loading model...", "does not begin with TLC1"),
        (b"TLC1" + b"\xff" * 12, "longer than the protocol allows"),
        (b"TLC1" + (2).to_bytes(4, "little") + bytes(8) + b"[]", "no JSON object"),
        (message({"type": "hello", "protocol": 2}), "this file knows protocol 1"),
        (message({"type": "fame"}), "of a type that protocol 1 does not have"),
        (message({}), "has no type"),
        (setup(SMALL, ()), "setup came before hello"),
        (frame(0, ALL.view(np.uint8), ALL), "a frame came before setup"),
    ],
)
def test_what_should_not_be_said_ends_a_program_with_a_complaint(
    programs: dict[str, Path], sent: bytes, complaint: str
) -> None:
    with Peer(programs["echo"]) as peer:
        code, complaints = peer.end(sent)
    assert complaint in complaints
    assert code == (2 if complaint else 0)


@pytest.mark.parametrize("address", ["nowhere.invalid:1", "127.0.0.1:99999", "x", ""])
def test_an_address_that_is_none_is_told(programs: dict[str, Path], address: str) -> None:
    done = subprocess.run(
        [programs["echo"], "--listen", address],
        capture_output=True,
        check=False,
        timeout=20,
    )
    assert (done.returncode, b"--listen" in done.stderr) == (2, True)


# --- the cores themselves


@pytest.fixture
def nearest_view(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(EXAMPLES)
    yield import_module("nearest_view").NearestView
    del sys.modules["nearest_view"]


def test_nearest_view_is_the_same_in_c_and_python(
    programs: dict[str, Path],
    nearest_view: Any,
    views: tuple[ReferenceView, ...],
    image: NDArray[np.uint16],
) -> None:
    rng = np.random.default_rng(3)
    images = [
        image,
        views[2].image,
        (16.0 * views[1].image + rng.normal(0, 300, image.shape)).clip(0, 4095).astype(np.uint16),
        np.full(SMALL.shape, 77, np.uint8),
    ]
    frames = [(one, mask) for one in images for mask in (ALL, rng.random(image.shape) < 0.3)]
    frames.append((image, np.zeros_like(ALL)))
    chosen = {"min_likeness": 0.1}
    core = nearest_view(CoreContext(SMALL, views, chosen))
    n_ok = 0
    with Peer(programs["nearest_view"]) as peer:
        peer.ask(hello(chosen))
        peer.ask(setup(SMALL, views))
        for number, (one, mask) in enumerate(frames):
            said, _ = peer.ask(frame(number, one, mask))
            result = core.locate(Frame(one, mask))
            assert (said["status"], said["reason"]) == (result.status, result.reason)
            if result.trs_from_cam is not None:
                n_ok += 1
                position_m = result.trs_from_cam.translation
                np.testing.assert_allclose(said["pose"]["position_m"], position_m, atol=1e-12)
    assert 4 <= n_ok < len(frames)


def test_tronlab_asks_them_by_pipe_with_shared_memory_and_by_socket(
    programs: dict[str, Path],
    echo: tuple[str, int],
    views: tuple[ReferenceView, ...],
    image: NDArray[np.uint16],
) -> None:
    """The other tests have a peer of their own; this is the one that scores."""
    prior = PosePrior(views[1].trs_from_cam, np.diag([1e-6] * 3 + [1e-4] * 3))
    shown = Frame(image, views[0].mask, number=11, time_s=1.5e9, prior=prior)
    results: list[NavigationResult] = []
    for where in (f"cmd:{programs['echo']}", f"tcp://{echo[0]}:{echo[1]}"):
        spec = replace(parse_core(where), settings={"number": 2.5}, seed=3)
        told = describe_core(spec, limit_s=10)
        assert (told.name, told.version, told.is_sequential) == ("echo", "2.5", False)
        with open_core(spec, CoreContext(SMALL, views, spec.settings, 3), limit_s=10) as core:
            results.append(core.locate(shown))
    for result in results:
        assert result.status == "ok", result.reason
        assert result.trs_from_cam is not None
        assert result.covariance is not None
        expected = views[1].trs_from_cam.as_matrix()
        np.testing.assert_allclose(result.trs_from_cam.as_matrix(), expected, atol=1e-12)
        np.testing.assert_array_equal(result.covariance, prior.covariance)
        assert (result.n_features, result.n_matches) == (views[0].mask.sum(), 3)
        assert result.uv_inliers.ravel()[:4].tolist() == [1.5e9, 3, image[0, 0], image[-1, -1]]
        assert result.uv_inliers.ravel()[5] == 2.5


def test_a_setting_of_the_wrong_kind_is_refused_in_both(
    programs: dict[str, Path], nearest_view: Any
) -> None:
    with pytest.raises(ValueError, match="min_likeness must be a number"):
        nearest_view(CoreContext(SMALL, (), {"min_likeness": "high"}))
    with Peer(programs["nearest_view"]) as peer:
        peer.ask(hello({"min_likeness": "high"}))
        said, _ = peer.ask(setup(SMALL, ()))
    assert said["type"] == "failed"
    assert "min_likeness must be a number" in said["reason"]


@pytest.fixture(scope="session")
def look(scene: Any, pose: Callable[..., RigidTransform]) -> Callable[..., ReferenceView]:
    """``look(z_m, x_m=0, y_m=0, tilt=(0, 0, 0))``: what is seen from there."""

    def see(z_m: float, **where: Any) -> ReferenceView:
        trs_from_cam = pose(z_m, **where)
        grey, depth = scene.see(trs_from_cam, LENS)
        image, mask = np.rint(grey).astype(np.uint8), np.isfinite(depth)
        return ReferenceView(0, trs_from_cam, image, depth.astype(np.float32), mask)

    return see


def tracked(peer: Peer, number: int, view: ReferenceView, prior: Any = None) -> dict[str, Any]:
    return peer.ask(frame(number, view.image, view.mask, prior=prior))[0]


def test_track_prior_is_as_good_as_it_says(
    programs: dict[str, Path], look: Callable[..., ReferenceView]
) -> None:
    """The priors are drawn from their covariance: so the errors are chi-square by the answers'."""
    rng = np.random.default_rng(1)
    sigma = np.repeat([np.radians(0.5), 0.03], 3)
    nees, offset_px, n_per_image = [], [], 5
    with Peer(programs["track_prior"]) as peer:
        peer.ask(hello())
        peer.ask(setup(LENS, [look(2.4), look(1.8)]))
        for i in range(4):
            x_m, y_m = rng.normal(0, 0.08, 2)
            view = look(rng.uniform(1.7, 2.4), x_m=x_m, y_m=y_m, tilt=rng.normal(0, 0.03, 3))
            truth = view.trs_from_cam
            for j in range(n_per_image):
                prior = moved(truth, rng.normal(0, sigma))
                said = tracked(peer, n_per_image * i + j, view, (prior, np.diag(sigma**2)))
                assert said["status"] == "ok", said["reason"]
                answer = pose_said(said)
                error = np.concatenate(
                    [
                        (truth.rotation * answer.rotation.inv()).as_rotvec(),
                        truth.translation - answer.translation,
                    ]
                )
                covariance = np.reshape(said["covariance"], (6, 6))
                np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
                nees.append(error @ np.linalg.solve(covariance, error))
                seen = [LENS.project(it.inv().apply([[0, 0, 0]])) for it in (truth, answer, prior)]
                offset_px.append([np.linalg.norm(seen[0] - uv) for uv in seen[1:]])
    low, high = chi2.ppf([0.001, 0.999], 6 * len(nees))
    assert low < sum(nees) < high
    after_px, before_px = np.sqrt(np.mean(np.square(offset_px), axis=0))
    assert before_px > 2.0
    assert after_px < 0.5


def moved(pose: RigidTransform, by: NDArray[np.float64]) -> RigidTransform:
    turn = Rotation.from_rotvec(by[:3])
    return RigidTransform.from_components(pose.translation + by[3:], turn * pose.rotation)


def pose_said(said: dict[str, Any]) -> RigidTransform:
    rotation = Rotation.from_quat(said["pose"]["quaternion_xyzw"])
    return RigidTransform.from_components(said["pose"]["position_m"], rotation)


def test_track_prior_goes_on_from_its_own_answer(
    programs: dict[str, Path], look: Callable[..., ReferenceView]
) -> None:
    path = [look(2.0, x_m=0.06 * i, y_m=-0.03 * i) for i in range(4)]
    blank = np.full(LENS.shape, 9, np.uint8)
    with Peer(programs["track_prior"]) as peer:
        peer.ask(hello({"rotation_sigma_deg": 0.05}))
        peer.ask(setup(LENS, [look(2.1)]))
        prior = (path[0].trs_from_cam, np.diag(np.repeat([1e-3, 0.01], 3) ** 2))
        for i, view in enumerate(path):
            said = tracked(peer, i, view, prior if i == 0 else None)
            error_m = view.trs_from_cam.translation - pose_said(said).translation
            # The camera moves by 0.2 m; its range is that of the prior, as good as untouched.
            assert np.hypot(*error_m[:2]) < 0.02
            assert abs(error_m[2]) < 0.06
        peer.send(RESET)
        said = tracked(peer, 0, path[0])
        assert abs(pose_said(said).translation[2] - 2.1) < 0.02  # all it knows is the view
        said, _ = peer.ask(frame(1, blank, path[0].mask))
        assert "does not look as it should" in said["reason"]
        assert peer.end() == (0, "")


def test_track_prior_needs_reference_views_and_settings_that_are_numbers(
    programs: dict[str, Path], look: Callable[..., ReferenceView]
) -> None:
    with Peer(programs["track_prior"]) as peer:
        peer.ask(hello())
        assert peer.ask(setup(LENS, []))[0]["reason"] == "there are no reference views"
        peer.ask(hello({"min_likeness": "much"}))
        assert peer.ask(setup(LENS, [look(2.2)]))[0]["reason"] == "a setting is no number from 0"
