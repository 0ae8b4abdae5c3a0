"""The fit of one wall where something is wrong: another law, a lag, few beats, swapped channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recorded_walls import BEATS, N, T, loop, recording

from fitting.inference.models.loop import NoFit
from fitting.records.alignment.beats import Beats
from fitting.records.channels.spectral import resample, shift
from fitting.records.virtual import table_wall
from fitting.wall.fit_diagnostics import COLLINEAR
from fitting.wall.site_fit import bootstrap, fit, without_lag
from fitting.wall.wall_model import PARAMETERS

# --- what can go wrong --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("site", ["AA", "BT"])
def test_quadratic_law_on_loops_that_follow_the_monotone_one(site: str) -> None:
    """A known bias: the quadratic regression takes φ0 too large and |φ_NL| too small, and says so.

    Measured on these loops: φ0 +3.2 and +3.6 %, φ_NL -25 and -26 %.
    """
    wall = table_wall(site)
    fitted = fit(recording(wall, 40.0, 1), "S", wall.h, "nonlinear")
    assert 0.025 < fitted.values["phi0"] / wall.phi0 - 1.0 < 0.045
    assert -0.30 < fitted.values["phiNL"] / wall.phiNL - 1.0 < -0.20
    assert any("fit the monotone model" in text for text in fitted.warnings)
    assert any("does not describe the loop" in text and "see --lag" in text for text in fitted.warnings)


def test_time_lag() -> None:
    """1 ms by which P is late takes 5 % off φ0 in AA; ``by_lag`` predicts it, a free lag finds it (40 dB, 3 sigma)."""
    wall = table_wall("AA")
    beats = recording(wall, 40.0, 4)
    late = replace(beats, values=beats.values | {"S.P": shift(beats.values["S.P"], 1e-3 / T)})
    plain, moved = fit(beats, "S", wall.h), fit(late, "S", wall.h)
    change = moved.values["phi0"] / plain.values["phi0"] - 1.0
    assert -0.07 < change < -0.04
    assert plain.by_lag["phi0"] == pytest.approx(change, rel=0.05)
    free = fit(late, "S", wall.h, lag_free=True)
    lag, sd = free.lag
    assert abs(lag - 1e-3) < 3.0 * sd < 1e-3
    assert abs(free.values["phi0"] - wall.phi0) < 3.0 * free.sd("phi0")
    assert free.sd("phi0") > 2.0 * plain.sd("phi0")  # the price


@pytest.mark.parametrize("late", [-20e-3, 30e-3])
def test_large_lag(late: float) -> None:
    """P 20 ms early and 30 ms late, more than φ0/E = 17 ms: found, and everything that follows is without it.

    Lag and φ0 within 3 standard deviations; the bootstrap agrees with the interval, the loop's fit with the noise.
    """
    wall = table_wall("AA")
    beats = recording(wall, 40.0, 4)
    moved = replace(beats, values=beats.values | {"S.P": shift(beats.values["S.P"], late / T)})
    fitted = fit(moved, "S", wall.h, lag_free=True)
    assert abs(fitted.lag[0] - late) < 3.0 * fitted.lag[1] < 1e-3
    assert abs(fitted.values["phi0"] - wall.phi0) < 3.0 * fitted.sd("phi0")
    assert fitted.r2 > 0.999
    assert fitted.by_lag == {}
    assert fitted.parameter_set().provenance["lag_of_P"]["value"] == fitted.lag[0]
    for name, (low, high) in bootstrap(fitted, moved, 60, seed=1).items():
        assert low < fitted.values[name] < high
        assert 0.5 < (high - low) / np.subtract(*fitted.ci95(name)[::-1]) < 1.5, name
    np.testing.assert_allclose(without_lag(moved, fitted).mean("S.P"), beats.mean("S.P"), atol=0.02 * 4e3)


def test_misfit_of_a_noise_free_loop_is_reported() -> None:
    """The linear model on a clean monotone loop: without noise there is no χ²; the missed part of the pulse tells."""
    wall = table_wall("AA")
    texts = fit(recording(wall), "S", wall.h, "linear").warnings
    assert any("misses the noise-free loop by 0.0" in text for text in texts)


def test_start_without_ENL() -> None:
    """``extended`` models on noisy loops: where the regression has no wall, the start is that without E_NL.

    Of these 60 loops at 25 dB every one is fitted.
    """
    wall = table_wall("AA")
    for seed in range(60):
        assert fit(recording(wall, 25.0, seed), "S", wall.h, "extended monotone").values["E"] > 0.0


def test_radius_computed_from_pressure() -> None:
    """R a linear function of P, noise and all: nothing to weigh them by; one sentence, no LinAlgError."""
    wall = table_wall("AA")
    P = recording(wall, 40.0, 1).values["S.P"]
    beats = Beats("virtual.csv", "0", T, {"S.P": P, "S.R": 0.9e-2 + 1e-7 * P}, np.zeros(BEATS))
    with pytest.raises(NoFit, match=r"virtual.csv: site S: "):
        fit(beats, "S", wall.h)


def test_collinear_columns_are_reported() -> None:
    """With a pulse of 100 Pa the loop has no curvature: E, R0 and E_NL cannot be told apart."""
    wall = table_wall("CA")
    fitted = fit(recording(wall, 60.0, pulse=100.0), "S", wall.h, "extended")
    assert fitted.condition > COLLINEAR
    assert any("nearly collinear" in text for text in fitted.warnings)


@pytest.mark.parametrize(("part", "said"), [(0.1, None), (0.4, "39% below the modulus of the material")])
def test_a_thick_wall_is_reported(part: float, said: str | None) -> None:
    """h of a tenth and of four tenths of R0: (1 + x/2)/(1 + x)² of a thick wall's modulus, 0.612 at x = 0.4."""
    wall = table_wall("AA")
    texts = fit(recording(wall, 60.0, 1), "S", part * wall.R0).warnings
    found = [text for text in texts if "no thin wall" in text]
    assert len(found) == (said is not None) and all(str(said) in text for text in found)


def test_invisible_parameter_and_few_beats_are_reported() -> None:
    """φ_NL of CA at 30 dB; three beats."""
    wall = table_wall("CA")
    texts = fit(recording(wall, 30.0, 2, beats=3), "S", wall.h).warnings
    assert any("interval of phiNL contains 0" in text for text in texts)
    assert any("3 beats say little" in text for text in texts)


def test_bias_by_the_noise_of_R_is_reported() -> None:
    """At 20 dB on R alone, ordinary least squares is off by more than the interval in some parameter."""
    wall = table_wall("AA")
    clean = recording(wall)
    noisy = recording(wall, 14.0, 3).values["S.R"]
    fitted = fit(replace(clean, values={"S.P": clean.values["S.P"], "S.R": noisy}), "S", wall.h)
    assert any("noise of R biases ordinary least squares" in text for text in fitted.warnings)


def test_residual_spectrum_is_what_the_noise_says() -> None:
    """Mean of |residual_k|²/expected² over harmonics is 1 - p/N (white noise, 40 dB): within 15 %."""
    wall = table_wall("AA")
    ratio = []
    for seed in range(20):
        k, size, expected = fit(recording(wall, 40.0, seed), "S", wall.h).residual_spectrum()
        ratio.append(np.mean((size[1:-1] / expected[1:-1]) ** 2))
        assert len(k) == N // 2 + 1
    assert np.mean(ratio) == pytest.approx(1.0 - 4.0 / N, abs=0.15)


def test_swapped_channels_and_other_nonsense() -> None:
    """One sentence each: P and R swapped, R the wrong way round, P late by a fifth of a beat, h in the wrong unit."""
    wall = table_wall("AA")
    beats = recording(wall)
    P, R = beats.values["S.P"], beats.values["S.R"]

    def of(P: np.ndarray, R: np.ndarray) -> Beats:
        return replace(beats, values={"S.P": P, "S.R": R})

    with pytest.raises(ValueError, match=r"R/h = .* check the units of h and R"):
        fit(of(R, P), "S", wall.h)
    with pytest.raises(ValueError, match=r"swapped"):
        fit(of(R * 1e6, P * 1e-6), "S", wall.h)
    with pytest.raises(NoFit, match=r"site S: (E = .* is negative|no unstressed radius)"):
        fit(of(P, 2 * R.mean() - R), "S", wall.h)
    with pytest.raises(
        NoFit, match=r"phi0 = -[\d.]+ kPa·s is negative: the pressure comes after the radius.* with --lag"
    ):
        fit(of(shift(P, 0.08), R), "S", wall.h)
    with pytest.raises(ValueError, match=r"S.h = 0.38 m"):
        fit(beats, "S", 0.38)
    with pytest.raises(ValueError, match=r"X\.P"):
        fit(beats, "X", wall.h)
    with pytest.raises(ValueError, match=r"model 'cubic' is not known; use one of linear"):
        fit(beats, "S", wall.h, "cubic")


def test_parameter_set_of_a_fit() -> None:
    """Names, units, laws, intervals and provenance: what the FMU takes as start values."""
    wall = table_wall("AA")
    fitted = fit(recording(wall, 40.0), "S", wall.h)
    found = fitted.parameter_set()
    assert found.start_values() == {
        "network.eta": 0.5,
        "S.h": wall.h,
        **{f"S.{name}": fitted.values[name] for name in PARAMETERS},
        "network.elastic_law": "regression",
        "network.viscous_law": "monotone",
    }
    assert found.values["S.E"].ci95 == fitted.ci95("E")
    assert found.values["S.ENL"].ci95 is None
    assert found.provenance["gamma"] == {"value": fitted.filtered.gamma, "unit": "m"}
    assert found.provenance["kept_harmonics"] == list(fitted.filtered.kept)
    assert len(found.provenance["sha256"]) == 64


def test_resampling_keeps_the_loop() -> None:
    """P_fitted lies on the measured P to 1e-8 of the pulse without noise."""
    wall = table_wall("DD")
    fitted = fit(recording(wall, n=500), "S", wall.h)
    np.testing.assert_allclose(fitted.P_fitted, resample(loop(wall, 500)[0], 127), atol=4e3 * 1e-8)
