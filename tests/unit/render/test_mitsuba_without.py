"""What of the renderer mitsuba can be tested without Mitsuba."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tronlab.render import memory, photometry
from tronlab.render.mitsuba import backend as mitsuba_backend
from tronlab.render.mitsuba import photometry as mitsuba_photometry
from tronlab.render.mitsuba.renderer import open_mitsuba
from tronlab.render.mitsuba.scene import check_terrain_fits
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert
from tronlab.render.renderer import RenderError
from tronlab.terrain.heightmap import HeightMap

FLAT = HeightMap(np.zeros((5, 4), dtype=np.float32), 0.1, np.zeros(3))
FUNCTIONS = (
    Lambert(),
    LommelSeeliger(),
    LunarLambert(),
    LunarLambert(weight=0.3),
    Hapke(),
    Hapke(single_scattering_albedo=0.8, phase_asymmetry=0.5, phase_backward=-0.6),
)


@given(
    incidence_rad=st.floats(0, 1.57),
    emission_rad=st.floats(0, 1.57),
    azimuth_rad=st.floats(0, np.pi),
)
def test_both_writings_of_the_photometric_functions_agree(incidence_rad, emission_rad, azimuth_rad):
    mu0, mu = np.cos([incidence_rad, emission_rad])
    cos_phase = mu0 * mu + np.sin(incidence_rad) * np.sin(emission_rad) * np.cos(azimuth_rad)
    phase_rad = np.arccos(np.clip(cos_phase, -1, 1))
    for function in FUNCTIONS:
        # numpy has by the same names all of Dr.Jit that the functions need.
        again = mitsuba_photometry.reflected(np, function, mu0, mu, phase_rad)
        assert again == pytest.approx(
            float(photometry.reflected(function, mu0, mu, phase_rad)), rel=2e-5, abs=1e-9
        )


def test_missing_mitsuba_is_told_with_its_remedy(monkeypatch):
    monkeypatch.setattr(mitsuba_backend, "find_spec", lambda _: None)
    with pytest.raises(RenderError, match=r"needs the package mitsuba\n.*tronlab\[mitsuba\]"):
        open_mitsuba(FLAT)


@pytest.mark.parametrize(
    ("version", "message"),
    [(None, "LLVM's library is not found"), ((15, 0, 6), "LLVM found is 15.0.6, must be 17")],
)
def test_unfit_llvm_is_refused_before_it_ends_the_process(monkeypatch, version, message):
    drjit = SimpleNamespace(
        JitBackend=SimpleNamespace(LLVM=1),
        has_backend=lambda _: version is not None,
        detail=SimpleNamespace(llvm_version=lambda: version),
    )
    monkeypatch.setattr(mitsuba_backend, "find_spec", lambda _: object())
    monkeypatch.setattr(mitsuba_backend, "import_module", {"drjit": drjit}.__getitem__)
    with pytest.raises(RenderError, match=message) as raised:
        open_mitsuba(FLAT)
    assert "libllvm19" in str(raised.value)


def test_terrain_larger_than_memory_is_refused(monkeypatch, tmp_path):
    meminfo = tmp_path / "meminfo"
    monkeypatch.setattr(memory, "_MEMINFO", meminfo)
    terrain = HeightMap(np.zeros((1001, 1001), dtype=np.float32), 0.1, np.zeros(3))
    meminfo.write_text("MemTotal:  99999999 kB\nMemAvailable:  100000 kB\n")
    with pytest.raises(
        RenderError, match=r"2\.0 million triangles: needs about 0\.\d GB"
    ) as raised:
        check_terrain_fits(terrain)
    assert "0.1 GB are available" in str(raised.value)
    assert "every_n: 2" in str(raised.value)
    meminfo.write_text("MemAvailable:  1000000 kB\n")
    check_terrain_fits(terrain)
    meminfo.unlink()
    check_terrain_fits(terrain)
