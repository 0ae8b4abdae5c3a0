"""How numbers are written: digits by hand, signs, powers of ten, intervals; every page and table writes them so."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from fitting.pages.page import in_words, words
from fitting.results.estimate import Estimate
from solver.network.description import Segment
from solver.quantities.legible import (
    DASH,
    decimals,
    interval,
    number,
    plus_minus,
    rounded,
    shown_in,
    signed,
    significant,
)
from solver.quantities.quantity import quantities

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ("value", "three", "four", "sign"),
    [
        (1.4, "1.4", "1.400", "+1.4"),
        (-0.5, "−0.5", "−0.5000", "−0.5"),
        (0.0, "0", "0", "0"),
        (12345.6, "12300", "12350", "+12000"),
        (9.9996, "10", "10.00", "+10"),
        (0.000123456, "0.000123", "0.0001235", "+0.00012"),
        (4.5555e6, "4560000", "4556000", "+4600000"),
        (5.6e-6, "5.6·10⁻⁶", "5.6·10⁻⁶", "+5.6·10⁻⁶"),
        (-3.1e9, "−3.1·10⁹", "−3.1·10⁹", "−3.1·10⁹"),
        (math.nan, DASH, DASH, DASH),
        (math.inf, DASH, DASH, DASH),
    ],
)
def test_digits(value: float, three: str, four: str, sign: str) -> None:
    """Three digits, four with the zeros kept, and a difference with two."""
    assert (number(value), significant(value), signed(value)) == (three, four, sign)


def test_as_many_digits_as_the_interval_has() -> None:
    """Two digits of half the interval; a sharp value keeps its own digits, a wide one loses them."""
    assert [decimals(half) for half in (0.028, 1.0, 70.0)] == [3, 1, 0]
    assert rounded(1.40042, 0.028) == "1.400" and plus_minus(1.40042, 0.0284) == "1.400 ± 0.028"
    assert interval(1.537459, 1.538921) == "1.53746 … 1.53892"
    assert interval(-0.30001, 0.0001) == "−0.30 … 0.00"  # no −0
    assert plus_minus(5.0321e6, 7e4) == "5032000 ± 70000"
    assert rounded(2.5, math.nan) == "2.5" and rounded(2.5, 0.0) == "2.5" and interval(-math.inf, 1.0) == DASH
    assert str(Estimate(1.4e6, "Pa.s", (1.37e6, 1.43e6))) == "1400 (1370 to 1430) kPa·s"
    assert shown_in(quantities(Segment)["E"]) == ("MPa", 1e-6)


def test_provenance_in_words() -> None:
    """Texts and numbers are told in their units; tables of numbers and long lists are named only."""
    entries = {
        "record": "a.csv",
        "gamma": {"value": 1.2566e-7, "unit": "m"},
        "chi2_over_dof": 9.696288,
        "kept": [1, 2, 3],
        "channels": {"AA.P": 1.1000186},
        "warnings": [],
        "covariance": [[5.5e-8, -2.6e-8], [-2.6e-8, 1.1e-7]],
        "unknowns": {"all.E": {"x": -0.0005, "moves": {"AA.E": 1.0}}},
        "records": {f"{i}.csv": 64 * "a" for i in range(9)},
        "columns": {"map": {"ABP_Ao": "Ao.P"}, "decimal_mark": "comma"},
        "thresholds": {"HELD_OUT": 0.25},
    }
    told, data = in_words(entries)
    assert told == {
        "record": "a.csv",
        "gamma": "0.0001257 mm",
        "chi2 over dof": "9.696",
        "kept": "1, 2, 3",
        "channels": "AA.P: 1.1",
        "thresholds": "HELD_OUT: 0.25",
    }
    assert data == ["covariance", "unknowns", "records", "columns"]
    assert words(entries["columns"]) == "map: ABP_Ao: Ao.P; decimal mark: comma"  # titles and constants as they are


@pytest.mark.parametrize("table", ["fitting/pages", "fitting/cohort/report.py", "discrepancy/report/tables.py",
                                   "arterial_fmu/cli/tables/study.py", "arterial_fmu/study"])  # fmt: skip
def test_tables_write_numbers_by_the_one_way(table: str) -> None:
    """No format with significant digits or an exponent is left in what makes pages and tables of results."""
    paths = [ROOT / table] if table.endswith(".py") else sorted((ROOT / table).glob("*.py"))
    found = [
        f"{path.name}: {line.strip()}"
        for path in paths
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\{[^{}]*:\+?\.\d[ge]\}", line) and ".6g}" not in line  # of the CSV and the plot's data
    ]
    assert found == []
