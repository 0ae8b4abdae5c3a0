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
@pytest.mark.parametrize(
    ("index", "alike"),
    [
        pytest.param(22, {"external_pressure at VA2"}, id="an external pressure of a neighbour, three pressures"),
        pytest.param(23, {"channel_gain at BT.R"}, id="a gain of the radius for a taper of that artery, 20 dB"),
    ],
)
def test_laws_that_explain_the_record_elsewhere_are_in_the_class(index: int, alike: set[str]) -> None:
    """Records of the bank (`walls`, seed 20320201) in which another law, of another place, explains the record as well
    as the hidden one (their separation is 2.3 and 6.0): both are told, and neither alone."""
    cases, kind = whole("network", "walls", 20320201), "network"
    made = make(cases[index], seed_of(kind, 20320201, index))
    naming = judge(Record("made", "", made.time, made.channels, {}), made.base)[1]
    (effect,) = cases[index].effects
    assert naming.verdict == "ambiguous" and naming.complete
    assert {f"{effect.name} at {effect.where[0]}", *alike} <= {n.label for n in naming.members}
