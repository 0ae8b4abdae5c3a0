"""Tables of sources: in time as by harmonic balance, in the FMU as in the solver, in files, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmus import venous_flows

from build_fmu import build
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.importer.run import run_fmu
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Settings, beat_harmonics, load, simulate, simulate_periodic
from solver.errors import InputError
from solver.laws.outlets import Resistance, Windkessel
from solver.linear import waveforms
from solver.mesh.sources import BY_KIND, OutletFlow
from solver.network.curve import Curve
from solver.network.description import from_dict, to_dict
from solver.network.files import dumps, loads
from solver.network.table_source import KINDS, TableSource

Array = np.ndarray
K = 40


def table(kind: str, segment: str, T: float, size: float = 1.0, **how: float) -> TableSource:
    """Two harmonics of 2 mL/s and of 2 mmHg, some of them late, and a mean."""
    signal = KINDS[kind][0]
    unit = size * {"Q": 1e-6, "P": 133.0}[signal]
    return TableSource(kind, segment, Curve.series(signal, 0.5 * unit, np.array([2.0, 1.0]) * unit,
                                                   np.array([-1.0, 0.5]) * unit, T), how)  # fmt: skip


def both(network: Network) -> tuple[Array, Array, Array]:
    """Harmonics of all outputs in time and by balance, and their pulses."""
    names = [*network.output_units()]
    run = simulate_periodic(network, tolerance=1e-6, start="periodic")
    stepped = np.array([np.fft.rfft(run[n][:-1], norm="forward")[: K + 1] for n in names]).T
    pulse = np.array([np.ptp(run[n]) for n in names])
    return stepped, beat_harmonics(network, names, K, tolerance=1e-8)[0], pulse


@pytest.mark.parametrize(
    ("end", "kind", "segment", "how"),
    [
        pytest.param("reflection", "outlet", "CA", {}, marks=pytest.mark.slow),
        ("Windkessel", "outlet", "CA", {}),
        ("reflection", "wall", "CA", {"degree": 1.0}),
        ("reflection", "drop", "DD", {"start": 0.2, "end": 0.6}),
        pytest.param("reflection", "step", "CA", {"end": 0.0}, marks=pytest.mark.slow),
        pytest.param("reflection", "outflow", "AA", {}, marks=pytest.mark.slow),
    ],
)
def test_steps_and_balance_agree(end: str, kind: str, segment: str, how: Mapping[str, float]) -> None:
    """A source moves outputs by 0.3 % of a pulse and more, and the two solvers differ by no more than 1.1 times what
    they differ by without it, 3e-5 of the sheep (the steps' error), and 4e-6 (of beats that repeat to 1e-6)."""
    network = load("sheep")
    if end == "Windkessel":
        network = network.with_outlet(Windkessel("CA", R1=3e8, C=1e-10, R2=2e9))
    acting = replace(network, sources=(table(kind, segment, network.inlet.T, **how),))
    (plain, balanced, pulse), (stepped, found, _) = both(network), both(acting)
    usual = (np.abs(plain - balanced) / pulse).max()
    assert (np.abs(stepped - found) / pulse).max() <= 1.1 * usual + 4e-6
    assert (np.abs(stepped - plain) / pulse).max() >= 3e-3 > 20.0 * usual


def test_it_stands_beside_a_source_that_is_asked_for() -> None:
    """Half of g(t) from the network and half as a source of the call are all of it, of a batch too: to round-off."""
    sheep = load("sheep")
    whole, half = (table("outlet", "CA", sheep.inlet.T, size) for size in (1.0, 0.5))
    g = np.fft.rfft(half.curve.at(np.arange(64) / 64), norm="forward")[:3, None]
    names, E = ["CA.P", "AA.P"], {"CA.E": np.array([1.0, 1.2]) * sheep.segment("CA").E}
    one = beat_harmonics(replace(sheep, sources=(whole,)), names, 12, parameters=E)
    two = beat_harmonics(replace(sheep, sources=(half,)), names, 12, parameters=E, sources=[OutletFlow("CA")],
                         amplitudes=g)  # fmt: skip
    np.testing.assert_allclose(two, one, atol=1e-9 * np.abs(one).max())


def test_a_file_reads_back_and_says_what_is_wrong() -> None:
    """Every kind; the FMU's data; one sentence each of what cannot be."""
    sheep, T = load("sheep"), 0.5
    sources = tuple(table(kind, "CA", T) for kind in KINDS)
    network = replace(sheep, sources=sources)
    assert loads(dumps(network), "x") == network == from_dict(json.loads(json.dumps(to_dict(network))))
    assert BY_KIND.keys() == KINDS.keys()
    section = (
        '[[sources]]\nkind = "outlet"\nsegment = "CA"\nT = "500 ms"\nQ_mean = 0\nQ_cos = ["1 mL/s"]\nQ_sin = [0]\n'
    )
    (read,) = loads(f"{dumps(sheep)}\n{section}", "x").sources
    assert read.curve.at(0.0) == pytest.approx(1e-6) and read.curve.period == 0.5
    for old, new, said in (
        ("outlet", "outlets", "no such kind; use .*did you mean outlet"),
        ('"CA"', '"AA"', "network sheep has none there"),
        ('kind = "outlet"', 'kind = "wall"', "give P of a source wall"),
        ("Q_", "R_", "unknown key"),
        ('kind = "outlet"\n', "", r"must be sections \[\[sources\]\]"),
    ):
        with pytest.raises(InputError, match=said):
            loads(f"{dumps(sheep)}\n{section.replace(old, new)}", "x")
    for kind, how, said in (
        ("drop", {"start": 0.6, "end": 0.4}, "give start < end"),
        ("wall", {"degree": 0.5}, "a whole number from 0 to 2"),
        ("drop", {"end": 2.0}, "give one from 0 to 1"),
        ("outlet", {"end": 1.0}, "unknown key"),
    ):
        with pytest.raises(InputError, match=said):
            table(kind, "CA", T, **how)


def test_where_it_cannot_be_it_is_refused() -> None:
    """Another period, the paper's scheme and the linear theory; two beats of one table are a beat."""
    sheep = load("sheep")
    acting = replace(sheep, sources=(table("outlet", "CA", sheep.inlet.T),))
    with pytest.raises(InputError, match=r"repeats every 0.5 s and the beat every 0.6 s"):
        beat_harmonics(acting, ["CA.P"], 8, period=0.6)
    with pytest.raises(InputError, match="scheme 'muscl' does not have tables"):
        simulate(acting, duration=0.01, scheme="muscl")
    with pytest.raises(InputError, match="linear theory does not have tables"):
        waveforms(acting, np.ones(8), 0.5)
    twice = replace(sheep, sources=(table("outlet", "CA", 0.5 * sheep.inlet.T),))
    stepped, found, pulse = both(twice)
    assert (np.abs(stepped - found) / pulse).max() < 4e-5


@pytest.mark.slow
def test_the_fmu_has_it(tmp_path: Path) -> None:
    """The fourth beat from rest, through FMPy and by the solver: 2e-6 of each pulse, which the source moves by 1 %."""
    sheep = load("sheep")
    acting = replace(sheep, sources=(table("outlet", "CA", sheep.inlet.T), table("wall", "CA", sheep.inlet.T)))
    found = run_fmu(build(acting, tmp_path), None, 2.0)
    exact, plain = (simulate(n, duration=2.0, settings=Settings()) for n in (acting, sheep))
    for name in ("CA.P", "CA.Q", "AA.P", "CA.outlet.Q"):
        pulse = np.ptp(exact[name])
        assert np.abs(found[name][1500:] - exact[name][1500:]).max() <= 2e-6 * pulse
        assert np.abs(plain[name][1500:] - exact[name][1500:]).max() >= 1e-2 * pulse


def test_the_port_of_an_outlet_has_it() -> None:
    """What flows to P_venous is what the outlet lets through, so that P_venous = P_0 - Z Q_venous: to 1e-12."""
    sheep = load("sheep").with_outlet(Resistance("CA", R=2e9))
    acting = replace(sheep, sources=(table("outlet", "CA", sheep.inlet.T),))
    component = CoSimulation(acting, Settings())
    values = {v.name: v.start for v in variable_table(acting, Settings()) if v.causality != "output"}
    component.initialize(0.0, values)
    for i in range(20):
        component.step(i * 1e-3, 1e-3, values)
    said, P = component.ports(), component.outputs()[component.report.names.index("CA.outlet.P")]
    i = [outlet.segment for outlet in acting.outlets].index("CA")
    assert venous_flows(component)[i] == pytest.approx(P / 2e9, rel=1e-12)
    component.step(0.02, 1e-3, values)
    left = said["CA.outlet.P_0"] - said["CA.outlet.Z"] * venous_flows(component)[i]
    assert left == pytest.approx(0.0, abs=1e-12 * said["CA.outlet.Z"] * 1e-6)
