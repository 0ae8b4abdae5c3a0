"""Virtual animals: their walls, their spread, their files."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fitting.cohort.virtual import Truth, VirtualCohort, VirtualRecording, virtual_cohort, write_cohort
from fitting.records.read.record import read_record
from fitting.records.virtual import (
    SITES,
    VirtualWall,
    jarvik_pressure,
    pressure_at,
    solve_radii,
    solve_radius,
    table_wall,
)

# walls of every law; the others leave the quadratic law's range
WALLS = [
    *(table_wall(site) for site in SITES),
    *(table_wall(site, viscous="quadratic") for site in ("DD", "CA", "FA")),
    table_wall("MD", phiNL=0.0),
    table_wall("AA", elastic="beta"),
    table_wall("CA", elastic="beta", ENL=-2e5),
    table_wall("BT", ENL=2e5),
]


def _periods_and_pressures() -> tuple[np.ndarray, np.ndarray]:
    T = np.linspace(0.42, 0.6, len(WALLS))
    return T, np.array([jarvik_pressure(period, 10.5e3, 3.5e3) for period in T])


@cache
def _alone() -> list[np.ndarray]:
    """The radius of each wall by itself, at 256 points."""
    return [solve_radius(wall, p, T, 256) for wall, T, p in zip(WALLS, *_periods_and_pressures(), strict=True)]


def _pressure(wall: VirtualWall, R: np.ndarray, T: float) -> np.ndarray:
    """P = (h/((1-η²) R)) (σ_el(ε) + σ_v(ε̇)) of a radius at even points of a beat, dR/dt by its Fourier series."""
    strain = R / wall.R0 - 1.0
    k = np.arange(len(R) // 2 + 1)
    spectrum = np.where(k < len(R) // 2, 2j * np.pi / T * k, 0.0) * np.fft.rfft(strain)
    rate = np.fft.irfft(spectrum, len(R))
    r = wall.phiNL / wall.phi0
    elastic = (wall.E * strain + wall.ENL * strain**2) * (1.0 + strain if wall.elastic == "beta" else 1.0)
    if wall.viscous == "quadratic" or r == 0.0:
        viscous = wall.phi0 * rate * (1.0 + r * rate)
    else:
        viscous = wall.phi0 * np.expm1(2.0 * r * rate) / (2.0 * r)
    return wall.h / ((1.0 - wall.eta**2) * R) * (elastic + viscous)


def test_the_radius_fulfils_the_wall_law() -> None:
    """eq:general on 256 points with a spectral derivative, every law: P to 1.8e-9 of its pulse in AA, else 1.4e-10."""
    for wall, T, p, R in zip(WALLS, *_periods_and_pressures(), _alone(), strict=True):
        P = pressure_at(p, T, np.arange(256) / 256 * T)
        assert np.abs(_pressure(wall, R, T) - P).max() < 3e-9 * np.ptp(P), wall


def test_walls_solved_together_equal_walls_solved_one_by_one() -> None:
    """One integration of walls of all laws (1e-9) against that of each by itself (1e-13): 2e-9 of the pulse."""
    T, p = _periods_and_pressures()
    for R, alone in zip(solve_radii(WALLS, p, T, 64), _alone(), strict=True):
        assert np.abs(R - alone[::4]).max() < 4e-9 * np.ptp(alone)


def test_walls_without_a_solution_are_refused() -> None:
    """Quadratic law, φ_NL three times that of BT: the stress is beyond its largest one; a sentence that names φ_NL."""
    wall, p = table_wall("BT", viscous="quadratic", phiNL=-40e3), jarvik_pressure(0.5)
    with pytest.raises(ValueError, match=r"^virtual wall: phiNL = -40000 Pa.s\^2 has no strain rate .* monotone law"):
        solve_radius(wall, p, 0.5, 64)


def _logs(cohort: VirtualCohort, what: Callable[[VirtualWall], float]) -> np.ndarray:
    """log what(wall) : (animals, sites)."""
    sites = list(dict.fromkeys(site for _, site in cohort.truth))
    return np.log([what(truth.wall) for truth in cohort.truth.values()]).reshape(-1, len(sites))


def test_spread_between_animals_is_the_stated_one() -> None:
    """20 % of E and φ0, half of it common, correlation 0.8, 12.6 % of φ0/E; means of Table 1. 400 animals, 2 sites."""
    cohort = virtual_cohort(3, animals=400, sites=("MD", "CA"), beats=2)
    E, phi0 = _logs(cohort, lambda wall: wall.E), _logs(cohort, lambda wall: wall.phi0)
    se = 1.0 / np.sqrt(2 * 800)  # relative, of a standard deviation from 800 values, half of which are independent
    means, E, phi0 = (np.exp(E).mean(axis=0), np.exp(phi0).mean(axis=0)), E - E.mean(axis=0), phi0 - phi0.mean(axis=0)
    assert E.std() == pytest.approx(0.198, rel=4 * se)
    assert phi0.std() == pytest.approx(0.198, rel=4 * se)
    assert (phi0 - E).std() == pytest.approx(0.198 * np.sqrt(0.4), rel=4 * se)
    assert np.corrcoef(E.T)[0, 1] == pytest.approx(0.5, abs=4 * 0.75 / np.sqrt(400))
    assert np.corrcoef(E.ravel(), phi0.ravel())[0, 1] == pytest.approx(0.8, abs=4 * 0.36 / np.sqrt(400))
    for i, site in enumerate(("MD", "CA")):
        assert means[0][i] == pytest.approx(SITES[site][2], rel=4 * 0.2 / np.sqrt(400))
        assert means[1][i] == pytest.approx(SITES[site][3], rel=4 * 0.2 / np.sqrt(400))
    ratio = _logs(cohort, lambda wall: abs(wall.phiNL / wall.phi0))
    assert np.expm1(ratio.std(axis=0) ** 2) ** 0.5 == pytest.approx([0.3, 0.3], rel=4 / np.sqrt(800))
    assert _logs(cohort, lambda wall: wall.R0).std(axis=0) == pytest.approx([0.01, 0.01], rel=4 / np.sqrt(800))
    error = [np.log(r.R0 / t.wall.R0) for r, t in zip(cohort.recordings, cohort.truth.values(), strict=True)]
    assert np.std(error) == pytest.approx(0.005, rel=4 * se)


def test_heart_rates_pressures_and_noise_are_the_stated_ones() -> None:
    """T, mean and pulse in their spans, 15 beats, P and R of the wall law at 300 dB; at 40 dB noise of 1 ± 0.1 %."""
    cohort = virtual_cohort(5, animals=6, sites=("AA", "FA"), dB=300.0, drift=0.0, bits=None)
    for recording, truth in zip(cohort.recordings, cohort.truth.values(), strict=True):
        assert 0.40 <= truth.T <= 0.62 and abs(truth.T * 200 - round(truth.T * 200)) > 1e-6
        assert 15 * truth.T <= recording.time[-1] + 1 / 200 < 15 * truth.T + 1 / 200
        assert np.ptp(recording.P) == pytest.approx(truth.pulse, rel=1e-3)  # samples miss the very top
        assert 10e3 <= truth.mean <= 12e3 and 3.5e3 <= truth.pulse <= 4.5e3
        _law_holds(recording, truth)
    noisy = virtual_cohort(5, animals=6, sites=("AA", "FA"), dB=40.0, drift=0.0, bits=None)
    for clean, other in zip(cohort.recordings, noisy.recordings, strict=True):
        assert np.std(other.P - clean.P) == pytest.approx(0.01 * np.std(clean.P), rel=0.1)
        assert np.std(other.R - clean.R) == pytest.approx(0.01 * np.std(clean.R), rel=0.1)


def _law_holds(recording: VirtualRecording, truth: Truth) -> None:
    """P = K ε/s + K_h/s φ0 (e^{2rε̇} - 1)/(2r), with ε̇ by fourth-order differences of the samples."""
    wall, R, dt = truth.wall, recording.R, recording.time[1]
    rate = (8 * (R[3:-1] - R[1:-3]) - (R[4:] - R[:-4])) / (12 * dt * wall.R0)
    r, K_h = wall.phiNL / wall.phi0, wall.h / (0.75 * wall.R0)
    s = R[2:-2] / wall.R0
    P = K_h / s * (wall.E * (s - 1) + wall.phi0 * np.expm1(2 * r * rate) / (2 * r))
    assert np.abs(P - recording.P[2:-2]).max() < 6e-5 * truth.pulse  # of the differences


def test_the_same_seed_gives_the_same_animals_and_another_one_others() -> None:
    """Bit for bit."""
    one, two, other = (virtual_cohort(seed, animals=2, sites=("DD",), beats=2) for seed in (8, 8, 9))
    assert np.array_equal(one.recordings[1].R, two.recordings[1].R)
    assert one.truth == two.truth != other.truth


def test_exact_means() -> None:
    """The means of these very animals are those of Table 1, not only those of all that could be drawn; 1e-14."""
    walls = [t.wall for t in virtual_cohort(4, animals=5, sites=("PD",), beats=2, exact_means=True).truth.values()]
    table = table_wall("PD")
    for name in ("E", "phi0", "R0", "phiNL"):
        values = [getattr(wall, name) for wall in walls]
        assert np.mean(values) == pytest.approx(getattr(table, name), rel=1e-14) and np.std(values) > 0.0


def test_unknown_site() -> None:
    """One sentence with the sites of the paper."""
    with pytest.raises(ValueError, match="no site 'XX' in the paper; use AA, PD"):
        virtual_cohort(1, animals=2, sites=("AA", "XX"))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"dB": np.inf}, "dB = inf: must be from -20 to 300."),
        ({"dB": np.nan}, "dB = nan: must be from -20 to 300."),
        ({"animals": 0}, "animals = 0: must be at least 1."),
        ({"beats": 1}, "beats = 1: must be at least 2, as many as a period needs."),
        ({"rate": 0.0}, "rate = 0: must be positive and finite, in samples a second."),
        ({"rate": -200.0}, "rate = -200: must be positive and finite, in samples a second."),
        ({"rate": np.inf}, "rate = inf: must be positive and finite, in samples a second."),
        ({"drift": -0.1}, "drift = -0.1: must be from 0 to 100."),
        ({"bits": 0}, "bits = 0: must be from 1 to 64."),
    ],
)
def test_arguments_out_of_range(
    monkeypatch: pytest.MonkeyPatch, arguments: dict[str, float | str], sentence: str
) -> None:
    """One sentence with the allowed range, before any random number is drawn."""
    monkeypatch.setattr("numpy.random.default_rng", lambda seed: pytest.fail("computed"))
    with pytest.raises(ValueError, match=f"^virtual cohort: {re.escape(sentence)}$"):
        virtual_cohort(1, **arguments)  # type: ignore[arg-type]


def test_files_hold_the_recordings_and_say_that_they_are_virtual(tmp_path: Path) -> None:
    """Every record's name and animal begin with "virtual"; the values read back to rounding; the truth lies apart."""
    cohort = virtual_cohort(2, animals=2, sites=("AA", "CA"), beats=3)
    steps: list[tuple[float, str]] = []
    path = write_cohort(cohort, tmp_path / "new" / "folder", lambda fraction, what: steps.append((fraction, what)))
    names = [f"virtual-{name}.csv" for name in ("S01_AA", "S01_CA", "S02_AA", "S02_CA")]
    assert steps == list(zip((0.0, 0.25, 0.5, 0.75), names, strict=True))
    assert sorted(each.name for each in path.parent.glob("*_*.csv")) == names
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert list(rows[0]) == ["animal", "site", "record", "h [mm]", "R0 [mm]"]
    assert rows[3] == {
        "animal": "virtual-S02",
        "site": "CA",
        "record": "virtual-S02_CA.csv",
        "h [mm]": "0.78",
        "R0 [mm]": f"{1e3 * cohort.recordings[3].R0:.5g}",
    }
    record = read_record(path.parent / "virtual-S02_CA.csv")
    assert record.channels["CA.P"] == pytest.approx(cohort.recordings[3].P, rel=1e-14)
    assert record.channels["CA.R"] == pytest.approx(cohort.recordings[3].R, rel=1e-14)
    assert "Virtual animals: synthetic data" in (path.parent / "README.txt").read_text()
    truth = json.loads((path.parent / "truth.json").read_text())
    assert truth["data"] == "virtual animals: synthetic data, not measured"
    assert truth["settings"]["dB"] == 40.0 and truth["settings"]["bits"] == 12
    assert truth["recordings"][3]["wall"]["E"] == cohort.truth["virtual-S02", "CA"].wall.E
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be made"):
        write_cohort(cohort, tmp_path / "file" / "folder")
