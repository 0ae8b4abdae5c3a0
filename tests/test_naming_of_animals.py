"""Names where every wall differs from the file's: a record of the independent generator, P, Q and R at seven sites.

Every E is off by 8 %, φ0 by 20 %, R0 by 2 % and R_t by 0.02, each by itself, beside what all have in common; 40 dB. A
stenosis in such an animal: test_discrepancy_walls.py. One to two minutes each; of a fork, in seconds: test_outliers.py,
test_beside.py, test_discrepancy_walls.py.
"""

from __future__ import annotations

import pytest
from judged import judge
from truth.hide import Effect
from truth.plan import TUNING_SEED, seed_of, whole
from truth.records import Case, make

from discrepancy.name.verdict import Naming
from fitting.records.read.record import Record


@pytest.mark.endurance
def test_nothing_hidden() -> None:
    """None: walls that differ are this animal, and leave noise."""
    made = make(Case("network", "all", 40.0, walls=1.0), 7)
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    assert (naming.verdict, naming.walls, naming.complete) == ("none", "individual", True)
    assert naming.base.explains and not naming.members and naming.confidence > 0.9


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("case", "index"),
    [
        pytest.param(
            Case("network", "three pressures", 40.0, (Effect("wall_viscosity", ("CA",), 0.0121),), "elastic",
                 walls=0.5),
            223,
            id="viscosity that an outlet of another kind imitates",
        ),
        pytest.param(
            Case("network", "all", 40.0, (Effect("stress_relaxation", ("CA",), 0.0329),), "sheep",
                 viscous_law="quadratic", walls=0.5),
            224,
            id="a relaxation that the walls take up",
        ),
    ],
)  # fmt: skip
def test_what_shows_from_the_walls_of_the_file(case: Case, index: int) -> None:
    """Two records of the bank (seed 20310123): found where the search begins at the file's walls again, and not from
    walls that were fitted without the effect: the first was told as a Windkessel, the second was unknown."""
    made = make(case, (20310123, 1, index))
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    assert (naming.verdict, naming.best.label) == ("effect", f"{case.effects[0].name} at CA")
    assert naming.best.explains and naming.complete


@pytest.mark.endurance
def test_an_animal_that_there_hardly_is() -> None:
    """A Windkessel for the reflection of FA, three pressures, common walls: a record of the bank's tuning plan (seed
    11). Numbers of DD and VA2 nine spreads off meet the record to its noise without any effect; from these walls no
    law leads home, from the file's the true one does."""
    cases, index = whole("network", "standard", TUNING_SEED), 9
    made = make(cases[index], seed_of("network", TUNING_SEED, index))
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    assert (naming.verdict, naming.best.label) == ("effect", "terminal_compliance at FA")
    assert naming.best.explains and naming.complete


@pytest.mark.endurance
def test_a_law_that_explains_the_record_elsewhere_is_in_the_class() -> None:
    """A record of the bank (`walls`, seed 20320201) that an external pressure of a neighbour explains as well as the
    hidden one (separation 2.3): both are told, and neither alone."""
    effect, naming = _of_the_bank(22)
    assert naming.verdict == "ambiguous" and naming.complete
    assert {effect, "external_pressure at VA2"} <= {n.label for n in naming.members}


@pytest.mark.endurance
def test_a_law_that_explains_the_record_less_well_elsewhere_is_not() -> None:
    """A taper, 20 dB, beside a gain of the radius of that artery (separation 6.0): -2 ln evidence 14.6 apart, and the
    taper is named alone."""
    effect, naming = _of_the_bank(23)
    assert (naming.verdict, naming.best.label) == ("effect", effect) and naming.complete
    (rival,) = (n for n in naming.ranked if n.label == "channel_gain at BT.R")
    assert rival.score - naming.best.score == pytest.approx(14.6, abs=0.5)


def _of_the_bank(index: int) -> tuple[str, Naming]:
    case = whole("network", "walls", 20320201)[index]
    made = make(case, seed_of("network", 20320201, index))
    (effect,) = case.effects
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    return f"{effect.name} at {effect.where[0]}", naming
