"""An inlet that is driven by a table: the curve, the file, the network and the FMU."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from network_text import FORK
from refused import refused

from fmu_src.variables.arteries_variables import variable_table
from solver import Settings, read_network, simulate
from solver.network.curve import Curve
from solver.network.description import Network, from_dict, to_dict
from solver.network.files import dumps, loads

COARSE = Settings(dt=5e-3, element_length=0.1)
ROWS = "time [ms],Q [mL/s]\n0,10\n100,60\n250,20\n400,15\n800,10\n"


def fork(tmp_path: Path, table: str = ROWS, inlet: str = 'Q = "inflow.csv"') -> Network:
    (tmp_path / "inflow.csv").write_text(table, encoding="utf-8")
    path = tmp_path / "fork.toml"
    path.write_text(FORK.replace('Q_max = "55 cm^3/s"', inlet), encoding="utf-8")
    return read_network(path)


def test_order_of_the_spline() -> None:
    """Through samples of a smooth periodic function the periodic cubic spline is of order 4: 15.5 to 16.5 times less
    error for half the distance, 1.2e-5 of the range at 32 uneven points. The mean is that of a fine sum, to 1e-10.
    """

    def f(t: np.ndarray) -> np.ndarray:
        return np.exp(np.sin(2 * np.pi * t))

    fine, errors = np.linspace(0.0, 1.0, 4001), []
    for n in (32, 64, 128):
        t = np.linspace(0.0, 1.0, n + 1)
        curve = Curve.through("Q", t, f(t))
        errors.append(np.abs(curve.at(fine) - f(fine)).max())
        assert curve.mean == pytest.approx(curve.at(np.arange(20000) / 20000).mean(), abs=1e-10)
    assert errors[0] < 1e-4
    assert all(14.0 < a / b < 18.0 for a, b in zip(errors, errors[1:], strict=False))


def test_curve_through_its_points() -> None:
    """Both interpolations pass through uneven points, repeat, and have the mean of what they are, to round-off."""
    t, y = [0.0, 0.1, 0.25, 0.4, 0.8], [1.0, 6.0, 2.0, 1.5, 1.0]
    for interpolation in ("cubic", "linear"):
        curve = Curve.through("Q", np.array(t), np.array(y), interpolation)
        np.testing.assert_allclose(curve.at(np.array(t) / 0.8 + 3.0), y, rtol=1e-13)
        x = (np.arange(80000) + 0.5) / 80000
        assert curve.mean == pytest.approx(curve.at(x).mean(), rel=1e-8)
        assert curve.scaled(2.0, 0.5).mean == pytest.approx(2.0 * curve.mean, rel=1e-13)
        assert curve.scaled(2.0, 0.5).period == pytest.approx(0.4)


def test_fourier_series() -> None:
    """Of a table of a series with five harmonics, in even or uneven rows, five give that series, to 1e-12 of its size;
    and so do its coefficients. The mean is a_0, and fewer harmonics leave the others out of even rows.
    """
    rng = np.random.default_rng(7)
    cos, sin, mean, T = rng.normal(size=5), rng.normal(size=5), 2.0, 0.8

    def f(t: np.ndarray, K: int = 5) -> np.ndarray:
        angle = 2.0 * np.pi * np.multiply.outer(t / T, np.arange(1, K + 1))
        return mean + np.cos(angle) @ cos[:K] + np.sin(angle) @ sin[:K]

    even, fine = np.linspace(0.0, T, 41), np.linspace(-1.0, 3.0, 501)
    uneven = T * np.linspace(0.0, 1.0, 41) ** 1.3
    for t in (even, uneven):
        curve = Curve.through("Q", t, f(t), "fourier", harmonics=5)
        np.testing.assert_allclose(curve.at(fine / T), f(fine), rtol=0.0, atol=1e-12)
        assert curve.mean == pytest.approx(mean, abs=1e-13)
        assert curve.largest == pytest.approx(f(np.linspace(0.0, T, 20001)).max(), rel=1e-5)
        scaled = curve.scaled(2.0, 0.5)
        np.testing.assert_allclose(scaled.at(fine / scaled.period), 2.0 * f(2.0 * fine), rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(Curve.series("Q", mean, cos, sin, T).at(fine / T), f(fine), rtol=0.0, atol=1e-12)
    shorter = Curve.through("Q", even, f(even), "fourier", harmonics=3)
    np.testing.assert_allclose(shorter.at(fine / T), f(fine, 3), rtol=0.0, atol=1e-12)


def test_turned_round(tmp_path: Path) -> None:
    """A network with a table of its inflow, built to be driven by pressure: what its FMU carries reads back, T kept."""
    network = fork(tmp_path)
    turned = replace(network, inlet=replace(network.inlet, causality="pressure"))
    again = loads(dumps(turned), "again.toml").inlet
    assert (again.drive, again.curve, again.T, again.Q_max) == ("inlet.P", None, 0.8, 60e-6)


FOURIER = 'Q = "inflow.csv"\ninterpolation = "fourier"\nharmonics = {}'
SERIES = 'T = "0.8 s"\nQ_mean = "10 mL/s"\nQ_cos = ["1 mL/s", 2e-6]\nQ_sin = ["3 mL/s", 0]'


@pytest.mark.parametrize("inlet", [FOURIER.format(1), SERIES])
def test_fourier_series_of_a_file(inlet: str, tmp_path: Path) -> None:
    """A table, or coefficients with units, drive the network; text and data carry them on."""
    network = fork(tmp_path, inlet=inlet)
    assert network.inlet.curve is not None
    assert (network.inlet.T, network.inlet.curve.harmonics) == (0.8, 2 if inlet is SERIES else 1)
    if inlet is SERIES:
        assert network.inlet.Q_mean == pytest.approx(10e-6, rel=1e-13)
        assert network.inlet.Q(0.2) == pytest.approx(10e-6 + 3e-6 - 2e-6, rel=1e-13)
    assert loads(dumps(network), "again.toml") == network
    assert from_dict(json.loads(json.dumps(to_dict(network)))) == network


def test_inflow_of_a_file(tmp_path: Path) -> None:
    """The table's units are read, its length is the period, its inflow runs the network; text and data carry it on."""
    network = fork(tmp_path)
    assert network.inlet.T == 0.8
    assert network.inlet.Q_max == 60e-6
    assert network.inlet.drive == "inlet.Q"
    np.testing.assert_allclose(network.inlet.Q(np.array([0.1, 0.9, 0.4])), [60e-6, 60e-6, 15e-6], rtol=1e-12)
    again = loads(dumps(network), "again.toml")
    assert again == network
    assert from_dict(json.loads(json.dumps(to_dict(network)))) == network
    result = simulate(network, duration=0.1, settings=COARSE)
    np.testing.assert_allclose(result["inlet.Q"], network.inlet.Q(result.time), rtol=1e-14)


def test_pressure_of_a_list(tmp_path: Path) -> None:
    """P as a list beside times drives the inlet by its pressure; a period longer than the table closes it."""
    inlet = 't = [0, "200 ms", 0.5]\nP = ["80 mmHg", "120 mmHg", 1.2e4]\nT = "0.8 s"\ninterpolation = "linear"'
    network = fork(tmp_path, inlet=inlet)
    assert network.inlet.drive == "inlet.P"
    assert network.inlet.given is not None
    np.testing.assert_allclose(network.inlet.given(np.array([0.8, 0.5])), [80 * 133.322387415, 1.2e4], rtol=1e-14)
    result = simulate(network, duration=0.05, settings=COARSE)
    np.testing.assert_allclose(result["inlet.P"], network.inlet.given(result.time), rtol=1e-14)
    assert loads(dumps(network), "again.toml") == network


def test_scaled_for_the_start_of_an_fmu(tmp_path: Path) -> None:
    """with_mean keeps the shape: Q(t) of another mean and period is the old one, scaled, at the same phase."""
    inlet = fork(tmp_path).inlet
    other = inlet.with_mean(2.0 * inlet.Q_mean, 0.4)
    t = np.linspace(0.0, 0.4, 9)
    np.testing.assert_allclose(other.Q(t), 2.0 * inlet.Q(2.0 * t), rtol=1e-12)
    assert other.Q_mean == pytest.approx(2.0 * inlet.Q_mean, rel=1e-13)
    table = {v.name: v for v in variable_table(fork(tmp_path), COARSE)}
    assert (table["inlet.Q_mean"].start, table["inlet.T"].start) == (inlet.Q_mean, 0.8)
    assert "the inflow of the network" in table["network.start"].description


BAD = {
    "no file": (ROWS, 'Q = "flow.csv"', ["flow.csv: cannot be read", "check the path"]),
    "no name of a file": (ROWS, 'Q = "a\\u0000b"', ["a\\x00b", "no name of a file"]),
    "both": (ROWS, 'Q = "inflow.csv"\nQ_max = 1e-5', ["inlet: Q and Q_max", "keep one"]),
    "number": (ROWS, "Q = 3", ["inlet.Q = 3", "name of a table"]),
    "no times": (ROWS, "Q = [1, 2, 1]", ["inlet.Q", "needs a list t", "add t"]),
    "t alone": (ROWS, "t = [1, 2]", ["inlet.t", "give Q or P"]),
    "short period": (ROWS, 'Q = "inflow.csv"\nT = 0.7', ["inlet.T = 0.7 s", "shorter than the table, 0.8 s"]),
    "interpolation": (ROWS, 'Q = "inflow.csv"\ninterpolation = "best"', ["'best'", "cubic or linear"]),
    "open": (ROWS.replace("800,10", "800,11"), 'Q = "inflow.csv"', ["ends at 1.1e-05", "begins at 1e-05", "period T"]),
    "backwards": (ROWS.replace("400,", "200,"), 'Q = "inflow.csv"', ["t = 0.2 s after 0.25 s", "correct"]),
    "text": (ROWS.replace("60", "sixty"), 'Q = "inflow.csv"', ["inflow.csv, line 3", "sixty", "number"]),
    "cells": (ROWS.replace("250,20", "250"), 'Q = "inflow.csv"', ["inflow.csv, line 4", "1 cells under 2 names"]),
    "column": (ROWS.replace("Q [", "flow ["), 'Q = "inflow.csv"', ["one column Q or inlet.Q", "time, flow"]),
    "unit": (ROWS.replace("mL/s", "mmHg"), 'Q = "inflow.csv"', ["line 2", "mmHg", "m^3/s"]),
    "empty": ("time,Q\n", 'Q = "inflow.csv"', ["table of 1 rows"]),
    "few": ("time,Q\n0,1\n1,1\n", 'Q = "inflow.csv"', ["table of 2 rows", "3 to 2000"]),
    "no harmonics": (
        ROWS,
        'Q = "inflow.csv"\ninterpolation = "fourier"',
        ["inlet.harmonics is missing: a Fourier series has at least 1"],
    ),
    "harmonics": (
        ROWS,
        'Q = "inflow.csv"\ninterpolation = "fourier"\nharmonics = 2',
        ["inlet.harmonics = 2", "5 rows 1 at most"],
    ),
    "half a harmonic": (ROWS, 'Q = "inflow.csv"\nharmonics = 1.5', ["inlet.harmonics = 1.5", "whole number"]),
    "of a spline": (ROWS, 'Q = "inflow.csv"\nharmonics = 1', ["inlet.harmonics = 1", "only a Fourier series"]),
    "bunched": (
        "time,Q\n0,1\n1e-9,2\n2e-9,3\n3e-9,2\n1,1\n",
        FOURIER.format(1),
        ["inlet.harmonics = 1", "too uneven", "fewer"],
    ),
    "no period": (ROWS, SERIES.replace('T = "0.8 s"', ""), ["inlet.T: it is missing", "a series needs a positive one"]),
    "no time": (ROWS, SERIES.replace("0.8 s", "0 s"), ["inlet.T: 0 s is no period"]),
    "no sines": (ROWS, SERIES.partition("Q_sin")[0], ["inlet.Q_sin: it is missing"]),
    "one sine": (ROWS, SERIES.replace(", 0]", "]"), ["inlet.Q_cos: 2 cosines and 1 sines"]),
    "sine without list": (ROWS, SERIES.replace('["3 mL/s", 0]', "3"), ["inlet.Q_sin = 3: must be a list"]),
    "series and table": (ROWS, f'{SERIES}\nQ = "inflow.csv"', ["inlet: Q_cos and Q both prescribe"]),
    "series and pressure": (ROWS, f"{SERIES}\nP_mean = 3", ["inlet: Q_cos and P_cos both prescribe"]),
    "unit of a sine": (ROWS, SERIES.replace('"3 mL/s"', '"3 mL"'), ["inlet.Q_sin", "3 mL", "m^3/s"]),
    "nan": (ROWS.replace("60", "nan"), 'Q = "inflow.csv"', ["line 3", "finite"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_tables(case: str, tmp_path: Path) -> None:
    """One sentence with the network file, the table and its line or the key, and what to do."""
    table, inlet, words = BAD[case]
    refused(lambda: fork(tmp_path, table, inlet), f"{tmp_path / 'fork.toml'}: ", words)
