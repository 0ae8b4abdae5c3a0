"""Networks drawn by hypothesis: the engine and its FMU do what NumPy does, failures included.

``pytest -m endurance --seeds 10`` draws a thousand of them.
"""

from __future__ import annotations

from typing import Any

import pytest
from drawn_networks import (
    IN_EQUATIONS,
    Drawn,
    by_pulse,
    component_outputs,
    fmu_outputs,
    nearly,
    networks,
    outcome,
    outputs,
)
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from native_fmus import needs_compiler

from fmu_src.variables.arteries_variables import INTERPOLATIONS
from solver.laws.effect import Effect
from solver.tracing import native

EQUAL = 1e-10  # of each channel's pulse
GENERATED: dict[str, Any] = {"phases": [Phase.generate], "suppress_health_check": list(HealthCheck)}


def equal(drawn: Drawn, found: Any, expected: Any) -> bool:
    """Whether two outcomes are the same sentence, or as many halvings and the same outputs."""
    if isinstance(found, str) or isinstance(expected, str):
        return bool(isinstance(found, str) and found == expected)
    same = by_pulse(tuple(drawn.network.output_units()), found[0], expected[0]) < EQUAL
    return bool(found[1] == expected[1] and same)


@pytest.mark.slow
@pytest.mark.parametrize("effect", IN_EQUATIONS, ids=lambda effect: effect.name)
@settings(max_examples=3, **GENERATED)
@given(st.data())
def test_engine(effect: Effect, data: st.DataObject) -> None:
    """With every effect of the catalogue: equal outputs and as many halvings of steps, or the same sentence, as NumPy
    has for the network or for one that differs from it by round-off."""
    try:
        native.library()
    except native.NoEngine as reason:
        pytest.skip(str(reason))
    assert_engine(data.draw(networks(effect)))


def assert_engine(drawn: Drawn) -> None:
    """Equal outcomes of the engine and of NumPy."""
    found = outcome(outputs, drawn, "native")
    assert any(equal(drawn, found, outcome(outputs, each, "numpy")) for each in nearly(drawn))


@pytest.mark.endurance
def test_engine_further(further_seed: int) -> None:
    """A hundred more networks with any effects."""

    @seed(further_seed)
    @settings(max_examples=100, database=None, **GENERATED)
    @given(networks())
    def draw(drawn: Drawn) -> None:
        assert_engine(drawn)

    draw()


@pytest.mark.slow
@needs_compiler
@settings(max_examples=5, **GENERATED)
@given(networks(), st.sampled_from(INTERPOLATIONS))
def test_fmu(drawn: Drawn, way: str) -> None:
    """The FMU that needs no Python against the component of the other one, tunable parameters changed between steps."""
    expected, found = outcome(component_outputs, drawn, way), outcome(fmu_outputs, drawn, way)
    if isinstance(expected, str):
        assert found == expected
    else:
        assert by_pulse(tuple(drawn.network.output_units()), found, expected) < EQUAL
