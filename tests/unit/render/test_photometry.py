"""The photometric functions against what others say of them."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss

from tronlab.render import photometry_kernel as kernel
from tronlab.render.photometry import (
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Photometry,
    reflected,
)

FUNCTIONS: list[Photometry] = [
    Lambert(),
    LommelSeeliger(),
    LunarLambert(),
    LunarLambert(weight=0.3),
    Hapke(),
]
IDS = ["lambert", "lommel_seeliger", "moon", "lunar_lambert", "hapke"]


@cache
def gauss(low, high, n=200):
    """Give nodes and weights for an integral."""
    x, weight = leggauss(n)
    return low + (x + 1) / 2 * (high - low), weight / 2 * (high - low)


def exact_h(w, n=96):
    """Solve Chandrasekhar's integral equation for isotropic scattering; give H at nodes of mu.

    S. Chandrasekhar, Radiative Transfer (1960), chapter V, in the form that iterates well:
    1 / H(x) = sqrt(1 - w) + w/2 integral over mu of mu H(mu) / (x + mu).
    """
    mu, weight = gauss(0, 1, n)
    h = np.ones_like(mu)
    for _ in range(400):
        h = 1 / (np.sqrt(1 - w) + w / 2 * (mu * h * weight / (mu[:, None] + mu)).sum(axis=1))
    return mu, h


def textbook_hapke(model, i, e, g):
    """Give pi r of Hapke's model from the angles, with Chandrasekhar's own function H."""
    w, b, c = model.single_scattering_albedo, model.phase_asymmetry, model.phase_backward
    mu, h = exact_h(w)
    h_i, h_e = np.interp(np.cos([i, e]), mu, h)
    surge = 1 + model.opposition_amplitude / (1 + np.tan(g / 2) / model.opposition_width)
    lobes = [(1 - b**2) / (1 - 2 * b * s * np.cos(g) + b**2) ** 1.5 for s in (1, -1)]
    p = (1 + c) / 2 * lobes[0] + (1 - c) / 2 * lobes[1]
    r = w / (4 * np.pi) * np.cos(i) / (np.cos(i) + np.cos(e)) * (surge * p + h_i * h_e - 1)
    return np.pi * r


@pytest.mark.parametrize("function", FUNCTIONS[:4], ids=IDS[:4])
def test_the_first_three_are_one_face_on(function):
    assert reflected(function, 1.0, 1.0, 0.0) == pytest.approx(1, abs=1e-7)


def test_lunar_lambert_is_a_mixture_with_mcewens_share():
    """L of McEwen's cubic at some phase angles, worked out by hand."""
    mu0, mu = 0.4, 0.7
    lommel_seeliger = 2 * 0.4 / 1.1
    for g_deg, share in [(0, 1.0), (30, 0.60838), (60, 0.41584), (90, 0.18586), (120, 0.0)]:
        expected = share * lommel_seeliger + (1 - share) * mu0
        got = reflected(LunarLambert(), mu0, mu, np.radians(g_deg))
        assert got == pytest.approx(expected, abs=1e-7)
    assert reflected(LunarLambert(weight=1.0), mu0, mu, 0.9) == reflected(
        LommelSeeliger(), mu0, mu, 0.9
    )
    assert reflected(LunarLambert(weight=0.0), mu0, mu, 0.9) == pytest.approx(mu0)


@pytest.mark.parametrize("angles_deg", [(0, 0, 0), (30, 20, 10), (60, 10, 50), (75, 60, 130)])
@pytest.mark.parametrize("model", [Hapke(), Hapke(single_scattering_albedo=0.9)])
def test_hapke_is_the_textbooks(model, angles_deg):
    i, e, g = np.radians(angles_deg)
    got = reflected(model, np.cos(i), np.cos(e), g)
    # H is approximated: within 1 % at w = 0.9, 0.1 % at the Moon's, of a part of the light.
    tolerance = 2e-3 if model.single_scattering_albedo < 0.3 else 2e-2
    assert got == pytest.approx(textbook_hapke(model, i, e, g), rel=tolerance)


@pytest.mark.parametrize(
    ("angles_deg", "expected"), [((0, 0, 0), 0.0965097), ((45, 30, 60), 0.0832883)]
)
def test_hapke_is_that_of_isis(angles_deg, expected):
    """What the unit test of USGS's ISIS holds its Hapke to: isotropic, w = 0.5, no surge.

    ISIS has the function H of 1981, 2 % lower here.
    """
    isotropic = Hapke(
        single_scattering_albedo=0.5,
        phase_asymmetry=0.0,
        phase_backward=0.0,
        opposition_amplitude=0.0,
    )
    i, e, g = np.radians(angles_deg)
    assert reflected(isotropic, np.cos(i), np.cos(e), g) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("w", "tolerance"), [(0.2, 1e-3), (0.5, 2e-3), (0.9, 8e-3), (0.99, 1e-2)])
def test_h_is_chandrasekhars(w, tolerance):
    mu, h = exact_h(w)
    np.testing.assert_allclose(kernel.chandrasekhar_h(w, mu), h, rtol=tolerance)


def test_h_of_a_white_medium():
    """Chandrasekhar's table has H(1) = 2.9078 for w = 1."""
    assert kernel.chandrasekhar_h(1.0, 1.0) == pytest.approx(2.9078, rel=1e-2)
    assert kernel.chandrasekhar_h(0.7, 0.0) == pytest.approx(1.0)


@given(b=st.floats(0, 0.8), c=st.floats(-1, 1))
def test_the_phase_function_has_a_mean_of_one(b, c):
    cos_g, weight = gauss(-1, 1)
    p = kernel.double_henyey_greenstein(b, c, cos_g)
    assert p.min() >= 0
    assert np.sum(p * weight) / 2 == pytest.approx(1, rel=1e-6)


@given(amplitude=st.floats(0.01, 4), width=st.floats(0.001, 1))
def test_the_opposition_surge(amplitude, width):
    """1 + B0 times the light of single scattering at phase 0, half of B0 at 2 atan(h)."""
    model = Hapke(opposition_amplitude=amplitude, opposition_width=width)
    plain = model.model_copy(update={"opposition_amplitude": 0.0})
    g = np.array([0.0, 2 * np.arctan(width), np.pi])
    surge = reflected(model, 0.6, 0.8, g) - reflected(plain, 0.6, 0.8, g)
    once = 0.222 / 4 * 0.6 / 1.4 * kernel.double_henyey_greenstein(0.254, 0.160, np.cos(g))
    np.testing.assert_allclose(surge / once, [amplitude, amplitude / 2, 0], rtol=1e-5, atol=1e-5)


angle = st.floats(0, np.radians(89.9))


@pytest.mark.parametrize("function", FUNCTIONS, ids=IDS)
@given(i=angle, e=angle, g=st.floats(0, np.pi))
def test_reciprocity(function, i, e, g):
    """Helmholtz: reflected / mu0 is the same with lamp and eye exchanged."""
    mu0, mu = np.cos([i, e])
    forth = reflected(function, mu0, mu, g) / mu0
    back = reflected(function, mu, mu0, g) / mu
    assert forth == pytest.approx(back, rel=1e-9)


def light_sent_back(function, i):
    """Integrate over the hemisphere: the part of the light that an albedo of 1 sends back."""
    mu, w_mu = gauss(0, 1, 120)
    azimuth, w_azimuth = gauss(0, np.pi, 120)
    mu, azimuth = mu[:, None], azimuth[None]
    cos_g = np.cos(i) * mu + np.sin(i) * np.sqrt(1 - mu**2) * np.cos(azimuth)
    factor = reflected(function, np.cos(i), mu, np.arccos(np.clip(cos_g, -1, 1)))
    return 2 * np.sum(factor * mu * w_mu[:, None] * w_azimuth) / np.pi / np.cos(i)


@pytest.mark.parametrize("i_deg", [0, 40, 80, 88])
def test_no_surface_sends_back_more_than_it_gets(i_deg):
    i = np.radians(i_deg)
    assert light_sent_back(Lambert(), i) == pytest.approx(1, rel=1e-6)
    # In closed form 4 (1 - mu0 ln((1 + mu0) / mu0)): as the docstring says, up to 4.
    mu0 = np.cos(i)
    expected = 4 * (1 - mu0 * np.log((1 + mu0) / mu0))
    assert light_sent_back(LommelSeeliger(), i) == pytest.approx(expected, rel=1e-4)
    assert 0.25 * light_sent_back(LunarLambert(), i) < 1
    # Of isotropic scatterers exactly 1 - sqrt(1 - w) H(mu0) (Chandrasekhar).
    w = 0.96
    bright = Hapke(single_scattering_albedo=w, opposition_amplitude=0.0, phase_asymmetry=0.0)
    expected = 1 - 0.2 * np.interp(mu0, *exact_h(w))
    assert light_sent_back(bright, i) == pytest.approx(expected, rel=0.02)
    assert light_sent_back(Hapke(), i) < 0.222


def test_the_default_is_a_lunar_mare():
    """The normal albedo of the mare at Apollo 11 is 0.1 to 0.13, and it brightens at full Moon."""
    face_on = reflected(Hapke(), 1.0, 1.0, np.radians([0, 5, 30]))
    assert 0.09 < face_on[1] < face_on[0] < 0.14
    assert face_on[0] / face_on[2] > 2


@pytest.mark.parametrize("function", FUNCTIONS, ids=IDS)
def test_arrays_of_any_shape_and_lamps_behind_the_surface(function):
    mu0 = np.array([[-0.2], [0.0], [0.5]])
    mu = np.array([0.6, 0.0, -0.1, 1.0])
    factor = reflected(function, mu0, mu, 0.7)
    assert factor.shape == (3, 4)
    assert np.isfinite(factor).all()
    assert np.all(factor[:2] == 0)
    assert np.all(factor[2] > 0)
    assert factor[2, 2] == factor[2, 1]


def test_the_arc_cosine_is_one():
    x = np.linspace(-1, 1, 20001)
    np.testing.assert_allclose(kernel.arccosine(x), np.arccos(x), atol=2.2e-8)
