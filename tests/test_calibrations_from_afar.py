"""Calibrations whose five start values are off by a factor of three each (benchmarks/calibrations.py makes them)."""

from __future__ import annotations

import pytest

from benchmarks.calibrations import FAR, NUMBERS, judge


@pytest.mark.parametrize(("tube", "said"), [(0, None), (3, None), (33, "there is no periodic beat; from other start")])
def test_from_afar(tube: int, said: str | None) -> None:
    """At least four of five 95 % intervals hold the truth, χ²/dof is that of noise, and a sentence says where another
    start was needed. Of tube 33, whose outlet begins with a third of its resistances, the wall collapses at the start.
    """
    row = judge(tube, 3.0, 1)
    assert not row.failed and row.within >= len(NUMBERS) - 1 and row.chi2 < FAR
    assert [said in text for text in row.said] == [True] if said else row.said == ()
