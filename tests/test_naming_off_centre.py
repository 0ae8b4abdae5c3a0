"""Effects of a part of a segment, and one that no catalogue has beside one that it has: whole records of the
independent generator, P, Q and R at seven sites, 40 dB, walls with all in common; one to two minutes each.

The same of a fork, in seconds, comes first; a drop beside its site where walls differ is in test_discrepancy_walls.py,
an effect beside what is in no catalogue in test_discrepancy_partial.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, exact, record
from truth.hide import Effect
from truth.records import Case, make

from discrepancy.find.study import prepare
from discrepancy.name.intervals import stated
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.hypothesis import candidates
from fitting.inference.models.network_record import network_problem
from fitting.records.read.record import Record
from fitting.results.estimate import Estimate
from solver.laws.effects import BY_NAME


def alone(effect: Effect, label: str) -> dict[str, Estimate]:
    """What is stated of an effect that is the whole answer, at the end of its search."""
    naming, found = named(effect)
    assert (naming.verdict, naming.best.label, naming.complete) == ("effect", label, True)
    return found


def named(*effects: Effect) -> tuple[Naming, dict[str, Estimate]]:
    """The verdict on a record that hides effects, and what is stated of the best answer's first effect."""
    made = make(Case("network", "all", 40.0, effects), 7)
    study = prepare(Record("made", "", made.time, made.channels, {}), made.base)
    naming = name(study.problem, study.terms, walls="common")
    return naming, stated(study.network, naming, naming.best, naming.best.fit.terms[0])


def part(found: dict[str, Estimate], key: str) -> tuple[float, float]:
    """Where the part begins and ends [x/L], as far as it lies in the segment."""
    middle, half = found[f"{key}_position"].value, 0.5 * found[f"{key}_length"].value
    return max(middle - half, 0.0), min(middle + half, 1.0)


# --- of a fork --------------------------------------------------------------------------------------------------------

SOUGHT = ("wall_stiffness", "side_branch", "stenosis", "terminal_reflection")


def of_fork(effect: str, numbers: dict[str, float], *beside: str) -> dict[str, Estimate]:
    """What is stated of an effect of B, the best name of a record at 40 dB. beside : names that need not be ruled
    out."""
    hidden = BY_NAME[effect].add(NETWORK, "B", numbers)
    problem = network_problem(record(exact(network=hidden), 10, 0.01), NETWORK)
    naming = name(problem, [t for t in candidates(NETWORK, CHANNELS) if t.effect in SOUGHT], walls="common")
    assert (naming.best.label, naming.complete) == (f"{effect} at B", True)
    assert naming.verdict == ("effect" if len(naming.members) == 1 else "ambiguous")
    assert {each.label for each in naming.members} <= {f"{effect} at B", *beside}
    return stated(NETWORK, naming, naming.best, naming.best.fit.terms[0])


@pytest.mark.deep
def test_a_stiffer_part_of_a_fork() -> None:
    """E of B is half as large again as far as x/L = 0.6: where it ends to 0.01 (0.603 measured), E to 0.1 %."""
    found = of_fork("wall_stiffness", {"E_scale": 1.5, "E_position": 0.3, "E_length": 0.6})
    assert part(found, "B.E")[1] == pytest.approx(0.6, abs=0.01)
    assert found["B.E_scale"].value == pytest.approx(1.5, rel=1e-3)
    low, high = found["B.E_length"].ci95
    assert low < 0.6 < high


@pytest.mark.deep
def test_a_leaking_part_of_a_fork() -> None:
    """Its whole conductance to 1 % (0.2 measured); the record does not tell its length, and the interval holds it.

    A leak of A close to the fork leaves 19 to 24 more of χ², at odds of 1 : 12 to 1 : 400: its minima are bent, and
    what a search finds there depends on its steps (costs of 108.4 to 114 found with derivatives after 1 to 8 steps). So
    A may stand beside B in the class; C may not.
    """
    found = of_fork("side_branch", {"leak": 2e-8, "leak_position": 0.3, "leak_length": 0.3}, "side_branch at A")
    begin, end = part(found, "B.leak")
    assert found["B.leak"].value * (end - begin) == pytest.approx(2e-8 * 0.3, rel=0.01)
    low, high = found["B.leak_length"].ci95
    assert low < 0.3 < high and high - low > 0.3


# --- of the sheep -----------------------------------------------------------------------------------------------------


@pytest.mark.endurance
def test_a_branch_before_the_site() -> None:
    """A tenth of the mean flow leaves CA between x/L 0.15 and 0.45: its whole conductance to 2 %, 1 % measured. The
    record tells where it ends; middle and length are in their intervals. Of seven draws of the noise, five leave the
    length open (intervals 0.25 to 0.77 wide), this one and another tell it to 0.12."""
    found = alone(Effect("side_branch", ("CA",), 0.1, position=0.3, length=0.3), "side_branch at CA")
    position, length = found["CA.leak_position"], found["CA.leak_length"]
    begin, end = part(found, "CA.leak")
    assert found["CA.leak"].value * (end - begin) == pytest.approx(0.1 * 15e-6 / 10e3 / 0.15, rel=0.02)
    assert end == pytest.approx(0.45, abs=0.05)
    assert position.ci95[0] < 0.3 < position.ci95[1]
    assert length.ci95[0] < 0.3 < length.ci95[1]


@pytest.mark.endurance
def test_a_wall_that_is_stiffer_up_to_the_middle() -> None:
    """E of DD is half as large again as far as x/L = 0.6: the end of the part to 0.01 (0.604 measured), E to 1 %."""
    found = alone(Effect("wall_stiffness", ("DD",), 0.5, position=0.3, length=0.6), "wall_stiffness at DD")
    assert part(found, "DD.E") == pytest.approx((0.0, 0.6), abs=0.01)
    assert found["DD.E_scale"].value == pytest.approx(1.5, rel=0.01)


@pytest.mark.endurance
def test_a_part_that_is_stiffer_before_the_site() -> None:
    """E of CA is half as large again between x/L 0.15 and 0.45: the part tops a class of two with one of BT, the next
    artery, 5 of -2 ln evidence behind. The record does not tell how stiff a part of what length: the intervals say so,
    and hold the truth."""
    naming, found = named(Effect("wall_stiffness", ("CA",), 0.5, position=0.3, length=0.3))
    assert naming.verdict in ("effect", "ambiguous") and naming.complete
    assert [n.label for n in naming.members][:1] == ["wall_stiffness at CA"]
    assert {n.label for n in naming.members} <= {"wall_stiffness at CA", "wall_stiffness at BT"}
    for key, truth in (("scale", 1.5), ("position", 0.3), ("length", 0.3)):
        low, high = found[f"CA.E_{key}"].ci95
        assert low < truth < high, key
    assert np.ptp(found["CA.E_length"].ci95) > 0.3


@pytest.mark.endurance
def test_a_long_stenosis() -> None:
    """K = 10 over x/L 0.32 to 0.52 of PD, across its site: K to 0.3 % (0.1 measured), its ends to 0.01 (0.003)."""
    found = alone(Effect("stenosis", ("PD",), 10.0, position=0.42, length=0.2), "stenosis at PD")
    assert part(found, "PD.K") == pytest.approx((0.32, 0.52), abs=0.01)
    assert found["PD.K"].value == pytest.approx(10.0, rel=0.003)


@pytest.mark.endurance
def test_a_stenosis_beside_what_is_in_no_catalogue() -> None:
    """Every wall's φ0 grows with its strain, φ0 (1 + 10 ε): the stenosis is named, K = 30 to 8 % (30.7 measured), and
    that more than noise remains, most in a radius. The map has both: a drop in the middle of MD, and all walls."""
    naming, found = named(Effect("stenosis", ("MD",), 30.0), Effect("strain_viscosity", ("all",), 10.0))
    assert (naming.verdict, naming.best.label, naming.complete) == ("partial", "stenosis at MD", True)
    assert [n.label for n in naming.members] == ["stenosis at MD"] and naming.confidence < 0.67
    assert found["MD.K"].value == pytest.approx(30.0, rel=0.08)
    assert naming.reason is not None and naming.reason.startswith("whitened RMS 3.") and "in CA.R" in naming.reason
    assert naming.map is not None and naming.map.explains
    assert [(p.kind, p.name) for p in naming.map.places] == [("drop", "MD"), ("wall", "all")]
