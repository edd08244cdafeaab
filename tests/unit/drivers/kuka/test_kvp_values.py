"""Values of KRL variables as text, as real controllers write them."""

import pytest

from drivers.kuka.krl_values import (
    format_axes,
    format_position,
    parse_axes,
    parse_bool,
    parse_enum,
    parse_position,
    parse_structure,
    parse_text,
)
from drivers.kuka.position import Axes, xyz_mm_abc_deg
from tronlab.kinematics.kr16 import forward


@pytest.mark.parametrize(
    "text",
    [
        "{E6AXIS: A1 -10.5, A2 -90.0, A3 90, A4 1.5E-05, A5 0.0, A6 +2e1, E1 1234.56789, E2 0.0}",
        "{A1 -10.5,A2 -90.0,A3 90,A4 1.5E-05,A5 0.0,A6 20,E1 1234.56789}",
        "  { e6axis :  a1 -10.5 , a2 -90.0,a3 90.0, a4 0.000015,a5 0,a6 20.0,e1 1234.56789 }  ",
    ],
)
def test_axes_are_read_in_every_way_they_are_written(text):
    axes = parse_axes(text)
    assert axes.arm_deg == pytest.approx((-10.5, -90, 90, 1.5e-5, 0, 20))
    assert axes.e1_mm == pytest.approx(1234.56789)


def test_members_that_are_not_needed_may_be_missing():
    pose = parse_position("{X 1.0, Y 2.0, Z 3.0, A 10.0, B 20.0, C 30.0}")
    assert xyz_mm_abc_deg(pose) == pytest.approx((1, 2, 3, 10, 20, 30))


def test_members_that_are_needed_may_not():
    with pytest.raises(ValueError, match=r"lacks A6, E1; it has A1, A2, A3, A4, A5"):
        parse_axes("{E6AXIS: A1 0, A2 0, A3 0, A4 0, A5 0}")


@pytest.mark.parametrize(
    "text", ["", "A1 0", "{A1}", "{A1 zero}", "{A1 nan}", "{A1 1 2}", "{{A1 0}}", "#T1"]
)
def test_what_is_no_structure_is_an_error(text):
    with pytest.raises(ValueError):  # noqa: PT011  # float() has words of its own
        parse_structure(text)


def test_a_structure_without_members_is_empty():
    assert parse_structure("{E6POS: }") == {}


@pytest.mark.parametrize(("text", "value"), [("TRUE", True), ("false", False), (" True ", True)])
def test_booleans(text, value):
    assert parse_bool(text) is value


@pytest.mark.parametrize("text", ["1", "", "#TRUE"])
def test_other_booleans_are_errors(text):
    with pytest.raises(ValueError, match="expected TRUE or FALSE"):
        parse_bool(text)


def test_enumeration_values():
    assert parse_enum("#P_ACTIVE") == "P_ACTIVE"
    assert parse_enum(" #t1") == "T1"
    with pytest.raises(ValueError, match="expected #NAME"):
        parse_enum("T1")


def test_texts_lose_their_quotation_marks():
    assert parse_text('"KR16 C2 "') == "KR16 C2"
    assert parse_text("KR16") == "KR16"


def test_what_is_written_is_read_again():
    axes = Axes.from_controller((1.25, -90.5, 100, -200, 45, 300), 3920.5)
    again = parse_axes(format_axes(axes))
    assert again.arm_deg == pytest.approx(axes.arm_deg, abs=1e-6)
    assert again.e1_mm == pytest.approx(axes.e1_mm, abs=1e-6)
    text = format_position(forward(axes.arm_rad), axes, status=2, turn=35)
    assert xyz_mm_abc_deg(parse_position(text)) == pytest.approx(
        xyz_mm_abc_deg(forward(axes.arm_rad)), abs=1e-6
    )
    members = parse_structure(text)
    assert (members["S"], members["T"], members["E1"]) == (2, 35, 3920.5)


def test_every_member_is_written_for_one_that_is_not_stays_undefined():
    axes = Axes.from_controller((0,) * 6, 0.0)
    assert set(parse_structure(format_axes(axes))) == {
        *(f"A{i}" for i in range(1, 7)),
        *(f"E{i}" for i in range(1, 7)),
    }
