"""Names where every wall differs from the file's: a record of the independent generator, P, Q and R at seven sites.

Every E is off by 8 %, φ0 by 20 %, R0 by 2 % and R_t by 0.02, each by itself, beside what all have in common; 40 dB. A
stenosis in such an animal: test_discrepancy_walls.py.
"""

from __future__ import annotations

import pytest
from truth.records import Case, make

from discrepancy.study import judge
from fitting.records.record import Record


@pytest.mark.slow
def test_nothing_hidden() -> None:
    """None: walls that differ are this animal, and leave noise."""
    made = make(Case("network", "all", 40.0, walls=1.0), 7)
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    assert (naming.verdict, naming.walls, naming.complete) == ("none", "individual", True)
    assert naming.base.explains and not naming.members and naming.confidence > 0.9
