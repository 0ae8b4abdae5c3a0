"""The unknowns of a calibration: their texts, the parameters that they move, and their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.inference.unknown import parameter_intervals, parameter_values
from fitting.inference.unknown_text import parse_unknown, parse_unknowns
from solver import Network, load


def test_common_scale(sheep: Network) -> None:
    """all.E: value = nominal e^x in all ten segments, prior 20 %."""
    unknown = parse_unknown("all.E", sheep)
    assert (unknown.kind, unknown.unit, unknown.prior_sd) == ("scale", "1", 0.2)
    values = parameter_values((unknown,), sheep, np.array([[0.0], [0.1]]))
    assert sorted(values) == sorted(f"{s.name}.E" for s in sheep.segments)
    for segment in sheep.segments:
        assert values[f"{segment.name}.E"][0] == segment.E
        assert values[f"{segment.name}.E"][1] == pytest.approx(segment.E * np.exp(0.1), rel=1e-14)


def test_common_shift_of_outlets(sheep: Network) -> None:
    """all.outlet.R_t and CA+FA.outlet.R_t: value = nominal + x, prior 0.2; x stops where the first outlet is closed."""
    unknown = parse_unknown("all.outlet.R_t", sheep)
    assert (unknown.kind, unknown.prior_sd, len(unknown.variables)) == ("shift", 0.2, 5)
    nominal = [sheep.parameters()[name] for name in unknown.variables]
    assert unknown.high == pytest.approx(1.0 - max(nominal)) and unknown.low == pytest.approx(-0.999 - min(nominal))
    group = parse_unknown("CA+FA.outlet.R_t:none", sheep)
    assert group.variables == ("CA.outlet.R_t", "FA.outlet.R_t") and group.prior_sd is None


def test_ratios() -> None:
    """phiNL is shifted as phiNL/phi0 [s] and ENL as ENL/E; the prior of phiNL is 30 % of BT, 1.38 s."""
    network = load("sheep_nonlinear")
    unknown = parse_unknown("all.phiNL", network)
    assert unknown.unit == "s" and unknown.prior_sd == pytest.approx(0.3 * 1.38, rel=1e-6)
    values = parameter_values((unknown,), network, np.array([0.5]))
    for segment in network.segments:
        assert values[f"{segment.name}.phiNL"] == pytest.approx(segment.phiNL + 0.5 * segment.phi0)
    assert parse_unknown("CA.ENL", network).moves == (("CA.ENL", network.segment("CA").E),)


def test_unknowns_add_up(sheep: Network) -> None:
    """all.E and CA.E together: CA.E = nominal e^(x1 + x2), and its interval takes both and their correlation."""
    unknowns = parse_unknowns(["all.E", "CA.E:0.1"], sheep)
    x = np.array([0.02, -0.05])
    E = sheep.segment("CA").E
    assert parameter_values(unknowns, sheep, x)["CA.E"] == pytest.approx(E * np.exp(-0.03), rel=1e-14)
    covariance = np.array([[4e-4, -1e-4], [-1e-4, 1e-4]])
    low, high = parameter_intervals(unknowns, sheep, x, covariance)["CA.E"]
    half = 1.959963984540054 * np.sqrt(3e-4)
    assert (low, high) == pytest.approx((E * np.exp(-0.03 - half), E * np.exp(-0.03 + half)), rel=1e-12)


def test_intervals_stay_in_the_allowed_range(sheep: Network) -> None:
    """R_t = 0.3 ± 1.96 sd ends at 1 and -0.999, and a logarithm known to ±10 or worse is the whole range."""
    unknowns = parse_unknowns(["CA.outlet.R_t", "fluid.nu:none"], sheep)
    intervals = parameter_intervals(unknowns, sheep, np.zeros(2), np.diag([4.0, 1e6]))
    assert intervals == {"CA.outlet.R_t": (-0.999, 1.0), "fluid.nu": (0.0, 1.0)}


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ([], "none given"),
        (["all.Ee"], r"unknown all\.Ee: nothing in network sheep has Ee; .* \(did you mean all\.E\?\)"),
        (["CA.phi"], r"unknown CA\.phi: .* not a parameter of network sheep; .* \(did you mean CA\.phi0\?\)"),
        (["CX.E"], r"CX\.E is not a parameter"),
        (["E"], r"not a parameter of network sheep; check the name \(did you mean all\.E\?\)"),
        (["CA+CA.E"], "occurs twice"),
        (["CA+FA.E", "FA+CA.E"], "move the same parameters"),
        (["CA.E:wide"], r"prior 'wide' must be a positive standard deviation or none, as in \"CA\.E:0\.1\""),
        (["CA.E:-0.1"], "must be a positive standard deviation"),
        (["CA.phiNL", "CA.E"], r"CA\.phi0 is 0, and phiNL is sought as a ratio"),
        (["CA.phi0"], "no factor can change"),
    ],
)
def test_refused_in_one_sentence(sheep: Network, texts: list[str], message: str) -> None:
    """Names, priors and values that cannot be, each in one sentence; CA is elastic here."""
    network = sheep.with_parameters({"CA.phi0": 0.0})
    with pytest.raises(ValueError, match=message):
        parse_unknowns(texts, network)
