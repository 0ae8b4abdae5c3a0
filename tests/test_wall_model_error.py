"""The error of a wall law: loops of walls with other laws, by a generator that shares no code with the fit."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_walls import BEATS, N, T, recording
from truth.beat import Beat
from truth.bench import radius
from truth.wall import Walls

from fitting.records.alignment.beats import Beats
from fitting.records.virtual import jarvik_pressure, pressure_at, table_wall
from fitting.wall import site_fit
from fitting.wall.indices import E_inc
from fitting.wall.site_fit import fit

E, R0, H, PHI0 = 5e5, 8e-3, 1e-3, 4e4
OMEGA = 2.0 * np.pi / T


@pytest.mark.parametrize("dB", [None, 40.0, 25.0])
def test_a_law_that_explains_the_loop_has_no_error(dB: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number is that of the noise alone: without noise, at 40 and at 25 dB, three sites each."""
    fits = [fit(recording(table_wall(site), dB, 3), "S", table_wall(site).h) for site in ("AA", "MD", "FA")]
    monkeypatch.setattr(site_fit, "_with_model_error", lambda beats, loop, kept: kept)
    for fitted, site in zip(fits, ("AA", "MD", "FA"), strict=True):
        by_noise = fit(recording(table_wall(site), dB, 3), "S", table_wall(site).h)
        assert fitted.model_error == 0.0
        assert (fitted.values, fitted.chi2, fitted.warnings) == (by_noise.values, by_noise.chi2, by_noise.warnings)
        assert np.array_equal(fitted.covariance, by_noise.covariance)


@pytest.mark.parametrize("behind_a_catheter", [True, False], ids=["springpot, catheter", "Maxwell"])
def test_another_viscous_law(behind_a_catheter: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A springpot behind a catheter that resonates at 18 Hz, and a Maxwell element of 20 ms, with slow noise of P.

    The dynamic E_inc of the first harmonic at the mean radius, E + s Re σ_v/ε, is in the interval of all six seeds.
    Weighted by the noise, which is least at high harmonics, it is in none: median +7.9 % (+2.2 to +13.3) instead of
    +5.4 % (-2.4 to +13.0), and +3.6 % (+0.2 to +6.8) instead of +2.6 % (-7.2 to +12.2).
    """
    P, R = _wave(behind_a_catheter)
    stress = 0.5**0.5 if behind_a_catheter else 0.02 * OMEGA / (1.0 + (0.02 * OMEGA) ** 2)
    true = E + R.mean() / R0 * PHI0 * OMEGA * stress

    def inside() -> int:
        found = [fit(_recording(P, R, seed, behind_a_catheter), "S", H, "linear") for seed in range(6)]
        return sum(low <= true <= high for low, high in (E_inc(each).ci95 for each in found))

    fitted = fit(_recording(P, R, 0, behind_a_catheter), "S", H, "linear")
    assert any("allow the law a random error of" in text for text in fitted.warnings)
    assert fitted.parameter_set().provenance["model_error"] == {"value": fitted.model_error, "unit": "Pa"}
    assert inside() == 6
    monkeypatch.setattr(site_fit, "_with_model_error", lambda beats, loop, kept: kept)
    assert inside() == 0


def test_the_error_is_that_of_all_laws() -> None:
    """One weighting for both elastic laws, in the fit; the evidence is that by the noise alone."""
    P, R = _wave(True)
    fitted = fit(_recording(P, R, 1, True), "S", H, "linear")
    assert {each.model_error for _, each in fitted.laws} == {fitted.model_error}
    assert fitted.model_error > 0.0
    assert len(fitted.laws) == 2


def _wave(catheter: bool) -> tuple[np.ndarray, np.ndarray]:
    """One clean beat of P and R : (N,)."""
    samples = 3 * N
    zero, one = np.zeros(1), np.ones(1)
    K_h = H / (0.75 * R0) * one
    wall = Walls(
        "regression", "monotone", A0=np.pi * R0**2 * one, K=E * K_h, e=zero, K_h=K_h, phi0=PHI0 * one, r=zero,
        tau=(0.0 if catheter else 0.02) * one, w=float(catheter) * one, order=0.5 * one, phi3=zero, c=zero,
        coulomb=zero, P_level=zero, beat=Beat(T, samples=samples),
    )  # fmt: skip
    P = pressure_at(jarvik_pressure(T), T, np.arange(samples) * T / samples)
    R = radius(wall, P)
    if catheter:
        f = np.fft.rfftfreq(samples, T / samples) / 18.0
        P = np.fft.irfft(np.fft.rfft(P) / (1.0 - f**2 + 0.4j * f), samples)
    return P[::3], R[::3]


def _recording(P: np.ndarray, R: np.ndarray, seed: int, catheter: bool) -> Beats:
    """Beats with white noise of a thousandth, and noise of P that falls with the harmonic."""
    rng = np.random.default_rng(seed)
    slow, power = (0.1, 2.0) if catheter else (0.02, 1.0)
    k = np.maximum(np.arange(N // 2 + 1), 1)
    drift = np.fft.irfft(np.fft.rfft(rng.normal(size=(BEATS, N))) / k**power, N)
    noise = 1e-3 * rng.normal(size=(2, BEATS, N))
    values = {"S.P": P + P.std() * (noise[0] + slow * drift), "S.R": R + R.std() * noise[1]}
    return Beats("virtual.csv", "0" * 64, T, values, np.zeros(BEATS))
