"""Networks drawn by hypothesis: the engine and its FMU do what NumPy does, failures included.

``python benchmarks/native_drawn.py`` draws as many as one likes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from drawn_networks import TIGHT, Array, Drawn, by_pulse, component_outputs, host, in_equations, networks, outcome, outputs
from fmpy.fmi1 import FMICallException
from fmus import Instance
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from native_fmus import needs_compiler

from build_fmu import build_native
from solver import NonPhysicalState
from solver.laws.effect import Effect
from solver.tracing import native

EQUAL = 1e-10  # of each channel's pulse
generated = {"phases": [Phase.explicit, Phase.generate], "suppress_health_check": list(HealthCheck)}


@pytest.mark.parametrize("effect", in_equations(), ids=lambda effect: effect.name)
@settings(max_examples=3, **generated)
@given(st.data())
def test_engine(effect: Effect, data: st.DataObject) -> None:
    """With every effect of the catalogue: equal outputs and as many halvings, or the same sentence."""
    try:
        native.library()
    except native.NoEngine as reason:
        pytest.skip(str(reason))
    drawn = data.draw(networks(effect))
    expected, found = outcome(outputs, drawn, "numpy"), outcome(outputs, drawn, "native")
    if isinstance(expected, str):
        assert found == expected
    else:
        assert found[1] == expected[1]
        assert by_pulse(list(drawn.network.output_units()), found[0], expected[0]) < EQUAL


def fmu_outputs(drawn: Drawn, way: str) -> Array:
    """The outputs of the FMU, as of :func:`component_outputs`. Raises NonPhysicalState with the sentence of its log."""
    with tempfile.TemporaryDirectory() as folder:
        instance = Instance(build_native(drawn.network, folder, TIGHT), Path(folder) / "fmu")
        instance.initialize({"inlet.interpolation": way})

        def step(t: float, changed: dict[str, float]) -> list[float]:
            instance.set(changed)
            instance.slave.doStep(t, TIGHT.dt)
            return instance.get(list(drawn.network.output_units()))

        try:
            return host(drawn, step)
        finally:
            instance.slave.freeInstance()
