"""Virtual branches and reflections, against the sheep network of the paper (Table 1)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from solver.laws.wall_laws import ELASTIC_LAWS, wave_speed
from solver.network.branching import admittance, matched_modulus, murray_radius, reflection_coefficient, virtual_branch
from solver.network.description import Segment
from solver.network.files import bundled, read_network

SHEEP = read_network(bundled("sheep"))
AA, PD, MD, DD, BT, CA, FA = (SHEEP.segment(name) for name in ("AA", "PD", "MD", "DD", "BT", "CA", "FA"))
VA1, VA2, VA3 = (SHEEP.segment(name) for name in ("VA1", "VA2", "VA3"))


@pytest.mark.parametrize(
    ("branch", "parent", "sibling", "error_R0", "error_E"),
    # published - derived: R0 0.0004, 0.0013, 0.0001 cm (the rows have three digits); E -0.68, +0.28, +0.036 %
    [(VA1, PD, MD, 5e-6, 0.007), (VA2, MD, DD, 1.4e-5, 0.003), (VA3, DD, FA, 1e-6, 0.0004)],
    ids=["VA1", "VA2", "VA3"],
)
def test_virtual_arteries_follow_from_the_other_rows(
    branch: Segment, parent: Segment, sibling: Segment, error_R0: float, error_E: float
) -> None:
    """R_p³ = ΣR_c³ and Y_p = ΣY_c give VA1-VA3 of Table 1 within the rounding of the table; errors beside each case."""
    derived = virtual_branch(parent, [sibling], branch.h, branch.L, branch.phi0, branch.name)
    assert derived.R0 == pytest.approx(branch.R0, abs=error_R0)
    assert derived.E == pytest.approx(branch.E, rel=error_E)
    assert replace(derived, R0=branch.R0, E=branch.E) == branch


@pytest.mark.parametrize(
    ("parents", "children", "gamma", "error"),
    [
        ([PD], [MD, VA1], 0.0, 0.0003),
        ([MD], [DD, VA2], 0.0, 0.0013),
        ([DD], [FA, VA3], 0.0, 0.00002),
        ([AA], [BT, PD], -0.20, 0.005),
        ([BT], [CA], 0.88, 0.005),
    ],
    ids=["PD", "MD", "DD", "AA", "BT"],
)
def test_reflection_in_the_sheep(parents: list[Segment], children: list[Segment], gamma: float, error: float) -> None:
    """Γ of Table 1 as printed: matched at PD, MD, DD (0.0002, 0.0013, 0.00001); AA -0.205 and BT +0.878 reflect."""
    assert reflection_coefficient(parents, children) == pytest.approx(gamma, abs=error)


def test_virtual_branch_is_matched() -> None:
    """The derived branch obeys Murray's law and reflects nothing, to round-off (3e-15), with two siblings too."""
    small = replace(FA, name="small")
    branch = virtual_branch(DD, [FA, small], h=5e-4, L=0.2)
    assert sum(s.R0**3 for s in (FA, small, branch)) == pytest.approx(DD.R0**3, rel=3e-15)
    assert reflection_coefficient([DD], [FA, small, branch]) == pytest.approx(0.0, abs=3e-15)


def test_a_branch_alone_is_the_parent() -> None:
    """Without siblings the branch of the parent's thickness is the parent, to round-off (3e-15)."""
    branch = virtual_branch(AA, [], AA.h, AA.L, AA.phi0)
    assert [branch.R0, branch.E] == pytest.approx([AA.R0, AA.E], rel=3e-15)


@pytest.mark.parametrize("eta", [0.0, 0.3, 0.5])
def test_admittance_is_that_of_the_wall(eta: float) -> None:
    """Y = A0/(ρ c0) with the solver's c0 at R = R0, to round-off (1e-15); c0² = 2Eh/(3ρR0) for η = 0.5."""
    rho = 1060.0
    K = np.array(AA.E * AA.h / ((1.0 - eta**2) * AA.R0))
    c0 = float(wave_speed(ELASTIC_LAWS["beta"], np.array(1.0), K, np.array(0.0), np.array(rho)))
    assert admittance(AA, rho, eta) == pytest.approx(math.pi * AA.R0**2 / (rho * c0), rel=1e-15)
    if eta == 0.5:
        c0 = math.sqrt(2.0 * AA.E * AA.h / (3.0 * rho * AA.R0))
        assert admittance(AA) == pytest.approx(math.pi * AA.R0**2 / (rho * c0), rel=1e-15)


@pytest.mark.parametrize(
    ("children", "gamma"), [([AA], 0.0), ([AA, AA], -1.0 / 3.0), ([], 1.0)], ids=["straight", "fork", "closed"]
)
def test_reflection_of_equal_arteries(children: list[Segment], gamma: float) -> None:
    """Γ = (1 - n)/(1 + n) when n equal arteries follow: 0, -1/3, and 1 for a closed end."""
    assert reflection_coefficient([AA], children) == pytest.approx(gamma, abs=1e-16)


def test_errors_say_what_and_what_to_do() -> None:
    """Siblings too large for the parent, a value outside its range, or no parents: one sentence each."""
    with pytest.raises(ValueError, match=r"AA\.R0 = 0\.00948 m: too large .* PD with R0 = 0\.0088 m.*check the radii"):
        murray_radius(PD, [AA])
    with pytest.raises(ValueError, match=r"MD\.R0 = 0\.00855 m and MD\.R0"):
        murray_radius(PD, [MD, MD])
    with pytest.raises(
        ValueError, match=r"BT and PD: .* 1\.515 of AA's.*\(the ratio must be below 1\); check R0, h and E"
    ):
        matched_modulus(AA, [BT, PD], R0=3e-3, h=1e-3)
    with pytest.raises(ValueError, match=r"VA\.h = -0\.001 m is not allowed: wall thickness h must lie in"):
        virtual_branch(PD, [MD], h=-1e-3, L=0.2)
    with pytest.raises(ValueError, match=r"VA9\.L = nan m is not allowed: length L must lie in"):
        virtual_branch(PD, [MD], h=1e-3, L=math.nan, name="VA9")
    with pytest.raises(ValueError, match="no parents; name at least one artery"):
        reflection_coefficient([], [AA])
