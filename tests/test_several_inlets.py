"""Networks with several inlets: a flow or a pressure is given at each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compare import relative_error
from fmus import COARSE
from refused import refused

from build_fmu import build, build_system
from fitting.check.fmu_check import _plan
from fitting.check.fmu_run import read_fmu
from fitting.records.channels.noise import check_flow_driven
from fitting.records.read.record import Record
from fitting.results.parameter_set import ParameterSet
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.documents.document import index_html
from fmu_src.documents.drawing import network_svg
from fmu_src.importer.run import run_fmu
from fmu_src.variables.arteries_variables import variable_table
from solver import MusclSettings, Settings, linear, sampled_inflow, simulate, simulate_periodic
from solver.errors import NotConverged
from solver.laws.outlets import Reflection, Windkessel
from solver.layout import lanes
from solver.network.curve import Curve
from solver.network.description import Fluid, Inlet, Junction, Network, Segment, Site, from_dict, to_dict
from solver.network.files import dumps, from_sections, loads
from solver.network.importers.sheet import read_sheet, to_sheet
from solver.scheme import step
from solver.scheme.model import build as build_model
from solver.scheme.outputs import inlet_answers
from solver.scheme.sdirk import INFLOW_TIMES

T = 0.5
A = Segment("A", L=0.1, R0=5e-3, h=5e-4, E=8e5, phi0=1e4)
B = Segment("B", L=0.15, R0=4e-3, h=5e-4, E=9e5, phi0=1e4)
C = Segment("C", L=0.2, R0=6e-3, h=6e-4, E=7e5, phi0=1e4)
SITES = (Site("A", "A"), Site("B", "B"), Site("C", "C"))
FLUID = {"inviscid": Fluid(nu=0.0), "blood": Fluid()}


def fork(*, outlet: Reflection | Windkessel | None = None, fluid: str = "blood", **changes: str) -> Network:
    """A and B flow together into C; the causality of the inlets in ``changes``."""
    first, further = (Inlet(s, Q_max=q, T=T, causality=changes.get(s, "flow")) for s, q in (("A", 2e-5), ("B", 1e-5)))
    return Network(
        "fork",
        (A, B, C),
        first,
        (Junction(("A", "B"), ("C",)),),
        (outlet or Windkessel("C", R1=3e7, C=1e-9, R2=4e8),),
        SITES,
        FLUID[fluid],
        further_inlets=(further,),
    )


def flows(size: float) -> dict[str, np.ndarray]:
    """Two unequal flows over a period, of few harmonics [m³/s]."""
    t = 2.0 * np.pi * np.arange(500) / 500
    return {"inlet.Q": size * (1.0 + np.sin(t)), "B.inlet.Q": size * (0.3 - np.cos(2.0 * t) + 0.2 * np.sin(3.0 * t))}


def in_time(samples: dict[str, np.ndarray]) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Functions of time through samples of a period, by cubics."""
    curves = {name: Curve.through("Q", np.linspace(0.0, T, 501), np.append(y, y[0])) for name, y in samples.items()}
    return {name: (lambda t, curve=curve: curve.at(t / T)) for name, curve in curves.items()}


def test_names() -> None:
    """The first inlet keeps its names; those of others begin with their segment, as those of outlets do."""
    network = fork(B="pressure")
    assert [(inlet.drive, inlet.answer) for inlet in network.inlets] == [
        ("inlet.Q", "inlet.P"),
        ("B.inlet.P", "B.inlet.Q"),
    ]
    assert list(network.output_units())[:2] == ["inlet.P", "B.inlet.Q"]
    assert network.channel_names()[:2] == ("inlet.Q", "B.inlet.P")
    assert from_dict(to_dict(network)) == network


def test_characteristic_impedances() -> None:
    """Two lossless tubes into an endless one, whose pressure at the junction is, with Z = ρc/A and kL = ωL/c,

    P = (Q_A/cos k_A L_A + Q_B/cos k_B L_B)/(1/Z_C + i tan(k_A L_A)/Z_A + i tan(k_B L_B)/Z_B):

    of the frequency domain to 1e-12, at seven frequencies.
    """
    segments = tuple(replace(s, phi0=0.0) for s in (A, B, C))
    network = replace(fork(outlet=Reflection("C", R_t=0.0), fluid="inviscid"), segments=segments)
    c = {s.name: np.sqrt(s.E * s.h / (0.75 * s.R0) / 2.0 / 1060.0) for s in segments}
    Z = {s.name: 1060.0 * c[s.name] / (np.pi * s.R0**2) for s in segments}
    omega = np.array([0.5, 3.0, 10.0, 30.0, 55.0, 80.0, 200.0])
    Q = {"inlet.Q": np.full(7, 2e-6 + 1e-6j), "B.inlet.Q": np.full(7, -1e-6 + 3e-6j)}
    h = linear.solve(network, Q, omega)
    kL = {s.name: omega * s.L / c[s.name] for s in segments}
    given = Q["inlet.Q"] / np.cos(kL["A"]) + Q["B.inlet.Q"] / np.cos(kL["B"])
    admittance = 1.0 / Z["C"] + 1j * np.tan(kL["A"]) / Z["A"] + 1j * np.tan(kL["B"]) / Z["B"]
    junction = linear.solve(replace(network, sites=(Site("x", "C", 0.0),)), Q, omega).P_site[0]
    np.testing.assert_allclose(junction, given / admittance, rtol=1e-12)
    np.testing.assert_allclose(h.Q_inlet, list(Q.values()), rtol=1e-12)


@pytest.mark.parametrize(
    ("A", "B"),
    [*(pytest.param("flow", B, marks=pytest.mark.slow) for B in ("flow", "pressure")), ("pressure", "pressure")],
)
def test_small_waves(A: str, B: str) -> None:
    """At small flows the beats are those of the frequency domain, with flows or pressures given: <= 2e-4 in L2."""
    both = fork(outlet=Reflection("C", R_t=0.3))
    exact = linear.waveforms(both, flows(1e-9), T)
    network = fork(outlet=Reflection("C", R_t=0.3), A=A, B=B)
    every = {**flows(1e-9), **exact}
    given = {name: every[name] for name in (i.drive for i in network.inlets)}
    beat = simulate_periodic(network, in_time(given), T, tolerance=1e-7)
    errors = {name: relative_error(name, beat[name][:-1], every[name]) for name in beat}
    assert max(errors.values()) <= 2e-4, errors


@pytest.mark.parametrize("scheme", ["staggered", "muscl"])
def test_one_tube_split(scheme: str) -> None:
    """Without friction two equal tubes under equal flows are one of twice the area under twice the flow.

    Case: 60 mL/s into walls that widen by some percent, until 0.3 s: to the tolerance of the solver, 1e-6.
    """
    settings = Settings(tolerance=1e-9) if scheme == "staggered" else MusclSettings(cell=0.01)
    two = replace(fork(fluid="inviscid"), segments=(A, replace(A, name="B"), C))
    two = replace(two, inlet=replace(two.inlet, Q_max=6e-5), further_inlets=(Inlet("B", 6e-5, T),))
    wide = replace(A, R0=A.R0 * np.sqrt(2.0), h=A.h * np.sqrt(2.0))
    joined = (Junction(("A",), ("C",)),)
    root = Inlet("A", 12e-5, T)
    one = replace(two, segments=(wide, C), junctions=joined, sites=SITES[::2], inlet=root, further_inlets=())
    split, whole = (simulate(network, duration=0.3, settings=settings, scheme=scheme) for network in (two, one))
    for name in ("C.P", "C.Q", "C.R", "A.P", "inlet.P", "C.outlet.P"):
        assert relative_error(name, split[name], whole[name]) <= 1e-6, name
    np.testing.assert_allclose(split["A.Q"] + split["B.Q"], whole["A.Q"], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(split["B.inlet.P"], split["inlet.P"], rtol=1e-12)


def test_mass() -> None:
    """Over a beat as much flows out as both inlets let in: to 1e-4 of it. From near the periodic state: 4 beats."""
    beat = simulate_periodic(fork(B="pressure"), {"B.inlet.P": lambda t: 5e3 + 2e3 * np.sin(2 * np.pi * t / T)})
    means = {name: np.mean(beat[name][:-1]) for name in ("inlet.Q", "B.inlet.Q", "C.outlet.Q")}
    assert means["inlet.Q"] + means["B.inlet.Q"] == pytest.approx(means["C.outlet.Q"], rel=1e-4)


def test_start_near_the_beats() -> None:
    """From the periodic start the first beat is within 1e-4 of the one that repeats; a batch has flows of its own."""
    network = fork()
    inflow = in_time(flows(1e-5))
    beat = simulate_periodic(network, inflow, tolerance=1e-6)
    first = simulate(network, inflow, T, start="periodic")
    errors = {name: relative_error(name, first[name], beat[name]) for name in beat}
    assert max(errors.values()) <= 1e-4
    twice = {**inflow, "B.inlet.Q": lambda t: np.multiply.outer(inflow["B.inlet.Q"](t), [1.0, 2.0])}
    batch = simulate(network, twice, duration=0.1, parameters={"C.phi0": np.full(2, C.phi0)}, start="periodic")
    assert batch["B.inlet.P"].shape == (2, 101)
    np.testing.assert_allclose(batch["inlet.P"][0], first["inlet.P"][:101], rtol=1e-3)


def test_halved_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a step does not converge its halves are driven as it was: flows that are cubics of time, to 1e-12."""
    network, dt = fork(), 2e-3
    model, real = build_model(network), step._advance

    def never_whole(model: Any, state: Any, length: float, *others: Any) -> Any:
        if length == dt:
            raise NotConverged("too long", "A", 0.0, 0.0, "none")
        return real(model, state, length, *others)

    def drive(t: np.ndarray) -> np.ndarray:
        return np.array([1e-5 + 2e-3 * t, 1e-5 * (t / dt) ** 3])

    halves = step.initial_state(model)
    for i in range(2):
        halves = step.step(model, halves, 0.5 * dt, drive((i + INFLOW_TIMES) * 0.5 * dt))
    monkeypatch.setattr(step, "_advance", never_whole)
    whole = step.step(model, step.initial_state(model), dt, drive(INFLOW_TIMES * dt))
    assert whole.halved == 1
    np.testing.assert_allclose(whole.Q, halves.Q, rtol=1e-12, atol=1e-18)


# --- the FMU ------------------------------------------------------------------------------------------------------


def component(network: Network, **values: str) -> tuple[CoSimulation, dict[str, float | str]]:
    made = CoSimulation(network, COARSE)
    starts = {v.name: v.start for v in variable_table(network, COARSE) if v.start is not None}
    starts |= {name.replace("__", "."): value for name, value in values.items()}
    made.initialize(0.0, starts)
    return made, starts


def test_fmu(tmp_path: Path) -> None:
    """An FMU of both inlets gives what the solver gives of straight lines between its steps: to round-off, 1e-9."""
    network = fork(B="pressure")
    fmu = build(network, tmp_path, settings=COARSE)
    t = np.arange(101) * COARSE.dt
    P = 2e3 * np.sin(2 * np.pi * t / T) ** 2
    found = run_fmu(fmu, network.inlet.Q, 0.2, step=COARSE.dt, inputs={"B.inlet.P": sampled_inflow(t, P)})
    inflow = {"inlet.Q": sampled_inflow(t, network.inlet.Q(t)), "B.inlet.P": sampled_inflow(t, P)}
    expected = simulate(network, inflow, 0.2, settings=COARSE)
    for name in expected:
        assert relative_error(name, found[name], expected[name]) <= 1e-9, name
    came = found["network.V"][-1] - found["network.V"][0] + found["venous.V"][-1]
    both = np.trapezoid(found["inlet.Q"], t) + np.trapezoid(found["B.inlet.Q"], t)
    assert came == pytest.approx(both, rel=1e-3)
    with pytest.raises(ValueError, match="fork: an FMU with further inlets \\(B.inlet.P\\)"):
        _plan(ParameterSet("none", {}), read_fmu(fmu), Record("record.csv", "", t, {"inlet.Q": t}))


@pytest.mark.parametrize("interpolation", ["hold", "linear", "smooth"])
def test_ports(interpolation: str) -> None:
    """The ports of both inlets foretell what they answer to another drive of their own: to 1 % of the change."""
    network, h = fork(B="pressure"), 2e-3
    changes = {"inlet.Q": 2e-6, "B.inlet.P": 100.0}
    for changed, change in changes.items():
        made, values = component(network, inlet__interpolation=interpolation, network__start="periodic")
        drives = {"inlet.Q": values["inlet.Q_mean"], "B.inlet.P": 500.0}
        for i in range(30):
            made.step(i * h, h, {**values, **drives})
        said, before = made.ports(), dict(zip(drives, made.shown.drive, strict=True))
        given = {**drives, changed: drives[changed] + change}
        if interpolation == "smooth":  # Q(t) as extrapolated, and then Q(t + h)
            made.step(30 * h, h, {**values, **drives})
        made.step((31 if interpolation == "smooth" else 30) * h, h, {**values, **given})
        i = list(drives).index(changed)
        found = inlet_answers(made.model, made.known.state if interpolation == "smooth" else made.shown.state)[0, i]
        place, (level, by) = changed[:-2], (("P_0", "Z") if changed[-1] == "Q" else ("Q_0", "Y"))
        expected = (
            said[f"{place}.{level}"]
            + said[f"{place}.{by}_0"] * before[changed]
            + said[f"{place}.{by}"] * given[changed]
        )
        assert found == pytest.approx(expected, abs=0.01 * abs(said[f"{place}.{by}"] * change))


def test_periodic_start_of_the_fmu() -> None:
    """With means of its own for each inlet, beats begin as the periodic start of the solver does: to 1e-12."""
    network = fork()
    made, values = component(network, network__start="periodic")
    assert [name for name in values if name.endswith(("_mean", "inlet.T"))] == [
        "inlet.Q_mean",
        "inlet.T",
        "B.inlet.Q_mean",
    ]
    expected = simulate(network, duration=0.01, settings=COARSE, start="periodic")
    names = list(network.output_units())
    np.testing.assert_allclose(made.outputs()[: len(names)], [expected[name][0] for name in names], rtol=1e-12)


def test_documents() -> None:
    """Both inlets are drawn, each at the height of its own artery on the left, and the page names what drives them."""
    network = fork(B="pressure")
    a, b, c = lanes(network)
    assert (a.x0, b.x0, a.y0, b.y0) == (0.0, 0.0, a.y, b.y)
    assert a.y != b.y
    assert (a.x1, a.y1) == (b.x1, b.y1) == (c.x0, c.y0)
    page = index_html(network, variable_table(network, COARSE), "0")
    assert "B.inlet.P</code> (answered by <code>B.inlet.Q</code>)" in page
    assert ">B.inlet.P</text>" in network_svg(network)


# --- files --------------------------------------------------------------------------------------------------------

TEXT = dumps(fork()).replace("[inlets.B]\n", "[inlets.B]\n# further\n")
BAD = {
    "no segment": ("[inlets.B]", "[inlets.D]", ["D.inlet", "no segment 'D'"]),
    "twice": ('segment = "A"\n', 'segment = "B"\n', ["second root beside B", "give it an inlet [inlets.A]"]),
    "inside": ("[inlets.B]", "[inlets.C]\n[inlets.B]", ["segment C: its upstream end is joined twice", "inlets.C"]),
    "segment": ("# further", 'segment = "B"', ["B.inlet.segment", "omit it"]),
    "key": ("# further", "Qmax = 1", ["B.inlet: unknown key 'Qmax'", "Q_max"]),
    "period": ('T = "0.5 s"\n\n[segments', 'T = "0.6 s"\n\n[segments', ["B.inlet.T = 0.6 s", "inlet.T is 0.5 s"]),
    "causality": ('causality = "flow"\nQ_max = "1e', 'causality = "both"\nQ_max = "1e', ["B.inlet.causality = 'both'"]),
    "unknown table": ("# further", 'P = "no.csv"', ["B.inlet: P and Q_max", "keep one"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_sections(case: str) -> None:
    """One sentence with the file, the inlet and what to do."""
    old, new, words = BAD[case]
    assert old in TEXT
    refused(lambda: loads(TEXT.replace(old, new), "fork.toml"), "fork.toml: ", words)


def test_files(tmp_path: Path) -> None:
    """There and back as TOML and as a table of vessels; the period is that of the inlet where nothing is said."""
    network = fork(B="pressure")
    assert loads(dumps(network), "again") == network
    short = TEXT.replace('"1e-05 m^3/s"\nT = "0.5 s"', '"1e-05 m^3/s"').replace('T = "0.5 s"', 'T = "0.7 s"')
    assert loads(short, "short").further_inlets[0].T == 0.7
    path = tmp_path / "fork.csv"
    path.write_text(to_sheet(network), encoding="utf-8")
    assert from_sections(read_sheet(path)) == replace(network)


def test_what_takes_one_inlet_only(tmp_path: Path) -> None:
    """One sentence where a run, a fit, or a heart would not know what to do."""
    with pytest.raises(ValueError, match="further inlets \\(B.inlet.Q\\), but records are compared with inlet.Q alone"):
        check_flow_driven(fork())
    with pytest.raises(ValueError, match="a heart drives one inlet"):
        build_system(fork(), "human", tmp_path)
    with pytest.raises(
        ValueError, match="inflow: C.inlet.Q does not drive an inlet of network fork; use inlet.Q, B.inl"
    ):
        simulate(fork(), {"C.inlet.Q": np.sin})
    for wrong, what in ((0.5, "0.5"), (np.zeros(3), "a ndarray"), (0.0, "0.0")):
        with pytest.raises(ValueError, match=f"inflow inlet.Q: {what} is no function of time; give one that takes"):
            simulate(fork(), wrong)
    with pytest.raises(ValueError, match="network fork: nothing drives B.inlet.P; give it as inflow"):
        simulate(fork(B="pressure"))
    with pytest.raises(ValueError, match="network fork has 2 inlets; give inlet.Q, B.inlet.Q by name"):
        linear.solve(fork(), np.ones(1), np.ones(1))
    with pytest.raises(ValueError, match="Q: it names inlet.Q; give what drives the inlets"):
        linear.solve(fork(), {"inlet.Q": np.ones(1)}, np.ones(1))
