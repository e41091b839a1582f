"""Live comparison with codes that we did not write, where they are installed.

The same numbers, frozen, are in the tests of the arm and the waves. Here the codes run, at
states and in seas that nobody chose.
"""

from dataclasses import replace

import numpy as np
import pytest
from arm_cases import UNEQUAL, WATER

from softwave_min.arm import Arm
from softwave_min.data import data_folder
from softwave_min.waves import Sea, Spectrum, jonswap_density
from softwave_min.waves.records import read_ndbc

WHY = "optional: CONTRIBUTING.md says how to install the codes"
GRAVITY = 9.81


@pytest.fixture(scope="module")
def soromox_arm():
    """`UNEQUAL` as a piecewise-constant-strain rod with bending alone."""
    pytest.importorskip("soromox", reason=WHY)
    import jax

    jax.config.update("jax_enable_x64", True)
    from jax import numpy as jnp
    from soromox.systems.components import LinkSpec
    from soromox.systems.pcs import PlanarPCS, PlanarPCSStructure

    links = [
        LinkSpec.circular(
            length=length,
            radius=diameter / 2,
            density=density,
            reference_strain=[0.0, 1.0, 0.0],
            stiffness=jnp.zeros((3, 3)),
        )
        for length, diameter, density in zip(
            UNEQUAL.length, UNEQUAL.diameter, UNEQUAL.density, strict=True
        )
    ]
    structure = PlanarPCSStructure(
        num_gauss_points=UNEQUAL.quadrature_points,
        strain_selector=jnp.array([True, False, False] * 3),
        scale_rotational_basis_by_length=True,
    )
    return PlanarPCS.from_links(
        links,
        structure=structure,
        gravity=jnp.array([0.0, -GRAVITY]),
        base_pose=jnp.array([UNEQUAL.base_angle, *UNEQUAL.base_position]),
    )


def test_soromox_has_the_same_arm(soromox_arm):
    """Inertia with rotary inertia, C q', weight and tips of an arm in air."""
    arm = Arm(UNEQUAL, replace(WATER, density=0.0))
    for q, qd in np.random.default_rng(17).uniform(-2.5, 2.5, (10, 2, 3)):
        close = {"rtol": 1e-6, "atol": 1e-7}
        np.testing.assert_allclose(arm.body_inertia(q), soromox_arm.inertia_matrix(q), **close)
        coriolis = np.asarray(soromox_arm.coriolis_matrix(q, qd)) @ qd
        np.testing.assert_allclose(arm.coriolis_vector(q, qd), coriolis, **close)
        np.testing.assert_allclose(
            arm.gravity_vector(q), soromox_arm.gravitational_force(q), **close
        )
        tips = np.asarray(soromox_arm.forward_kinematics_tips(q))[:, 1:]
        np.testing.assert_allclose(arm.segment_tips(q), tips, **close)


@pytest.mark.parametrize(("height", "depth", "length"), [(3.0, 54.0, 99.7), (0.1, 2.0, 40.0)])
def test_raschii_has_the_same_wave(height, depth, length):
    """Airy's wave, its z from the bed: period, elevation and velocity."""
    raschii = pytest.importorskip("raschii", reason=WHY)
    theirs = raschii.AiryWave(height, depth, length, g=GRAVITY)
    ours = Sea.regular(height, 2 * np.pi / theirs.omega, depth, GRAVITY)
    assert ours.wave_number[0] == pytest.approx(theirs.k, rel=1e-12)
    rng = np.random.default_rng(8)
    x, z, t = rng.uniform(-50, 50, 40), rng.uniform(-depth, -height, 40), rng.uniform(0, 60, 40)
    for place, level, time in zip(x, z, t, strict=True):
        elevation = float(theirs.surface_elevation(place, time)) - depth
        assert ours.elevation(place, time) == pytest.approx(elevation, abs=1e-9)
        velocity = np.ravel(theirs.velocity(place, level + depth, time, all_points_wet=True))
        np.testing.assert_allclose(ours.velocity(place, level, time), velocity, rtol=0, atol=1e-9)


@pytest.mark.parametrize("gamma", [1.0, 3.3, 5.0])
@pytest.mark.parametrize("period", [6.1, 10.0])
def test_wavespectra_has_the_same_jonswap(gamma, period):
    """Both scaled to H_m0 = 3 m on one grid, where their normalisations meet."""
    pytest.importorskip("wavespectra", reason=WHY)
    import xarray
    from wavespectra.construct.frequency import jonswap

    frequency = np.arange(0.02, 1.0, 0.002)
    grid = xarray.DataArray(frequency, coords={"freq": frequency}, dims="freq")
    theirs = jonswap(freq=grid, fp=1 / period, gamma=gamma, hs=3.0)
    curve = Spectrum(frequency, jonswap_density(frequency, 3.0, period, gamma))
    assert float(theirs.spec.hs()) == pytest.approx(3.0, rel=1e-6)
    ratio = theirs.values[10:] / curve.density[10:]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert ratio[0] == pytest.approx(1, abs=3e-3)


def test_wavespectra_reads_the_same_records():
    """The archive file that ships with the companion."""
    wavespectra = pytest.importorskip("wavespectra", reason=WHY)
    path = data_folder() / "buoys" / "41010w2019part.txt.gz"
    theirs = wavespectra.read_ndbc_ascii(str(path))
    ours = read_ndbc(path)
    assert theirs.sizes["time"] == len(ours)
    # It keeps single precision.
    close = {"rtol": 1e-6, "atol": 1e-9}
    for record in ours:
        spectrum = theirs.efth.sel(time=record.time)
        np.testing.assert_allclose(record.frequency_hz, spectrum.freq, **close)
        np.testing.assert_allclose(record.density, np.squeeze(spectrum), **close)
