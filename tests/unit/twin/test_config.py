import pytest
from pydantic import ValidationError

from tronlab.devices.protocols import Camera, Operator, PoseTracker, Robot, RoomIO
from tronlab.twin.config import CALLS, FaultSpec, WorldConfig


def test_world_needs_no_more_than_a_seed():
    assert WorldConfig(seed=3).sensor.full_well_e == 16000.0


def test_unknown_key_is_refused():
    with pytest.raises(ValidationError, match=r"sensor\.full_well"):
        WorldConfig.model_validate({"seed": 1, "sensor": {"full_well": 1.0}})


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("surface", "albedo", 1.2),
        ("surface", "rays_per_pixel", 2),
        ("surface", "photometry", "shiny"),
        ("robot", "repeatability_sigma_m", -1e-4),
        ("sensor", "full_well_e", 0.0),
        ("sensor", "read_noise_e", float("nan")),
        ("lens", "distortion", (0.1, 0.2)),
    ],
)
def test_value_out_of_range_is_refused(section: str, key: str, value: object):
    with pytest.raises(ValidationError, match=rf"{section}\.{key}"):
        WorldConfig.model_validate({"seed": 1, section: {key: value}})


@pytest.mark.parametrize(
    ("section", "key"),
    [
        ("tracker", "distance_range_m"),
        ("sensor", "exposure_range_s"),
        ("sensor", "gain_range_db"),
    ],
)
def test_ranges_must_be_in_order(section: str, key: str):
    with pytest.raises(ValidationError, match=f"{key}: the first value must not exceed the second"):
        WorldConfig.model_validate({"seed": 1, section: {key: (6.0, 3.0)}})


def test_fault_of_a_call_the_device_has_not_lists_what_it_has():
    with pytest.raises(ValidationError, match="camera has no 'move'; it has: connect, identify"):
        FaultSpec(device="camera", call="move", at=1, error="timeout")


def test_only_measuring_loses_the_beam():
    with pytest.raises(ValidationError, match="tracking_lost strikes measure_point"):
        FaultSpec(device="robot", call="move", at=1, error="tracking_lost")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"device": "robot", "call": "move", "moved_m": (0, 1, 0)}, "only the tracker can be mov"),
        ({"device": "tracker", "call": "connect"}, "moved_m: says how far"),
        (
            {"device": "tracker", "call": "connect", "error": "fault", "moved_m": (0, 1, 0)},
            "moved_m: says how far",
        ),
    ],
)
def test_only_a_tracker_is_moved_and_by_some_way(values, message):
    with pytest.raises(ValidationError, match=message):
        FaultSpec.model_validate({"at": 1, "error": "moved", **values})


def test_every_method_of_the_protocols_can_fail():
    protocols = {
        "robot": Robot,
        "tracker": PoseTracker,
        "camera": Camera,
        "room": RoomIO,
        "operator": Operator,
    }
    for kind, protocol in protocols.items():
        methods = {n for n in dir(protocol) if not n.startswith("_")} - {"name", "close"}
        assert set(CALLS[kind]) == methods
