"""The discretisation error of openBF's method: the method reimplemented, and its components changed one at a time.

    python benchmarks/openbf_method.py [--data DIR] [--networks ibif,cca] [--figure FILE] [--no-switch]

A network may be a file: that of `arterial-fmu import openbf DIR/adan56/adan56.yaml --as-run`, eight minutes.

The method, according to openBF's public source (version 2): cells of 1 mm; A and Q reconstructed with superbee slopes;
Lax–Friedrichs fluxes with the speed dx/dt; Heun steps at CFL 0.9; ghost cells that copy the end cells. The conditions
at inlet, junction and outlet, by Riemann invariants, overwrite A and Q of the end cells, vessel after vessel within a
step. Bifurcations conserve the static pressure, junctions of two vessels the total pressure. Runs start at rest with
empty Windkessels and end at the beat that openBF recorded, which is the reference, as in benchmarks/openbf.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from openbf import PLACES, compared, last_beat, reference, tabulate_errors, with_sites  # type: ignore[import-not-found]

from benchmarks.table import start
from solver import Network, Settings, Waveforms, Windkessel, load
from solver.muscl.slopes import van_albada

Array = np.ndarray
Slopes = Callable[[Array, Array], Array]

_NEWTON, _SETTLED = 20, 1e-12  # most corrections of an end cell, and the last one, of its area


def superbee(a: Array, b: Array) -> Array:
    """The largest slope that makes no new extremum (P. L. Roe, Annu. Rev. Fluid Mech. 18 (1986) 337)."""
    small, large = np.minimum(np.abs(a), np.abs(b)), np.maximum(np.abs(a), np.abs(b))
    return np.where(a * b > 0.0, np.copysign(np.minimum(2.0 * small, large), a), 0.0)


@dataclass
class Cells:
    """A vessel: P = P_ref + K (√(A/A0) - 1), c = k A^¼. U : (2, n + 2) A [m²] and Q [m³/s] with a ghost cell at both
    ends."""

    dx: float
    A0: float
    K: float
    k: float
    P_ref: float
    U: Array
    load: Any = None  # the Windkessel behind it, if any
    P_C: float = 0.0

    def pressure(self, A: Any) -> Any:
        return self.P_ref + self.K * ((A / self.A0) ** 0.5 - 1.0)


@dataclass
class End:
    """A vessel's end where it meets others, or its Windkessel: sign 1 its last cell, -1 its first. A : area there.

    Riemann's invariant W = u ± 4 c that reaches it holds u = W ∓ 4 c, so that du/dA = ∓ c/A.
    """

    vessel: Cells
    sign: float

    def __post_init__(self) -> None:
        self.cell = -2 if self.sign > 0.0 else 1
        self.A, Q = map(float, self.vessel.U[:, self.cell])
        self.W = Q / self.A + self.sign * 4.0 * self.vessel.k * self.A**0.25

    def at(self, rho: float) -> tuple[float, float, float, float]:
        """Flow into the node [m³/s] and P + (ρ/2) u² [Pa], each with its derivative by A."""
        v, c = self.vessel, self.vessel.k * self.A**0.25
        u = self.W - self.sign * 4.0 * c
        slope = 0.5 * v.K / (self.A * v.A0) ** 0.5  # dP/dA
        head = float(v.pressure(self.A)) + 0.5 * rho * u * u
        return self.sign * self.A * u, self.sign * u - c, head, slope - rho * u * self.sign * c / self.A

    def put(self) -> None:
        self.vessel.U[:, self.cell] = self.A, self.sign * self.at(0.0)[0]


def divergence(v: Cells, U: Array, speed: float, slopes: Slopes) -> Array:
    """Flux differences over the cells : (2, n) [value m/s]."""
    d = np.diff(U)
    half = np.zeros_like(U)
    half[:, 1:-1] = 0.5 * slopes(d[:, :-1], d[:, 1:])
    left, right_ = (U + half)[:, :-1], (U - half)[:, 1:]  # of every face
    flux = [np.stack([Q, Q * Q / A + v.k**2 / 1.5 * A**1.5]) for A, Q in (left, right_)]
    return np.diff(0.5 * (flux[0] + flux[1] - speed * (right_ - left)))


def advance(v: Cells, dt: float, friction: float, slopes: Slopes) -> None:
    """Heun's step of the cells, then friction."""
    first, half = v.U.copy(), v.U.copy()
    half[:, 1:-1] -= dt / v.dx * divergence(v, half, v.dx / dt, slopes)
    half[:, 0], half[:, -1] = half[:, 1], half[:, -2]
    v.U[:, 1:-1] = 0.5 * (first[:, 1:-1] + half[:, 1:-1] - dt / v.dx * divergence(v, half, v.dx / dt, slopes))
    v.U[1, 1:-1] *= 1.0 - dt * friction / v.U[0, 1:-1]


def meet(parent: Cells, daughters: list[Cells], rho: float) -> None:
    """ΣQ = 0 and one pressure in the end cells, the total one where the vessel goes on as one other: Newton."""
    ends = [End(parent, 1.0), *(End(d, -1.0) for d in daughters)]
    kinetic = rho if len(daughters) == 1 else 0.0
    for _ in range(_NEWTON):
        found = [end.at(kinetic) for end in ends]
        weights = [dQ / dH for _, dQ, _, dH in found]
        # heads linear in A: ΣQ + Σ dQ/dH (H - H_i) = 0
        H = sum(w * h - Q for w, (Q, _, h, _) in zip(weights, found, strict=True)) / sum(weights)
        moves = [(H - h) / dH for _, _, h, dH in found]
        for end, move in zip(ends, moves, strict=True):
            end.A += move
        if all(abs(move) < _SETTLED * end.A for end, move in zip(ends, moves, strict=True)):
            break
    for end in ends:
        end.put()


def leave(v: Cells, dt: float) -> None:
    """The Windkessel by Euler's step, then the area of the last cell from R1 Q = P - P_C by Newton.

    Its flow stays that of the fluxes."""
    v.P_C += dt / v.load.C * (v.U[1, -2] - v.P_C / v.load.R2)
    end = End(v, 1.0)
    for _ in range(_NEWTON):
        Q, dQ, P, dP = end.at(0.0)
        move = (P - v.P_C - v.load.R1 * Q) / (v.load.R1 * dQ - dP)
        end.A += move
        if abs(move) < _SETTLED * end.A:
            break
    v.U[0, -2] = end.A


def at_rest(network: Network, cell: float) -> list[Cells]:
    """Cells of the vessels at P_0, where A = A0 for it is P_ref, and empty Windkessels, as openBF starts."""
    loads = {o.segment: o for o in network.outlets if isinstance(o, Windkessel)}
    found = []
    for s in network.segments:
        n = max(5, int(np.ceil(s.L / cell - 1e-9)))
        A0, K = np.pi * s.R0**2, s.E * s.h / (1.0 - network.eta**2) / s.R0
        k = np.sqrt(K / (2.0 * network.fluid.rho)) / A0**0.25
        U = np.stack([np.full(n + 2, A0), np.zeros(n + 2)])
        found.append(Cells(s.L / n, A0, K, float(k), network.P_ref, U, loads.get(s.name)))
    return found


def simulated(
    network: Network, until: float, cell: float = 1e-3, cfl: float = 0.9, slopes: Slopes = superbee
) -> Waveforms:
    """The last beat before ``until`` [s], P and Q at the five places, in the cells that openBF records."""
    vessels, T, t = at_rest(network, cell), network.inlet.T, 0.0
    friction = np.pi * network.fluid.friction * network.fluid.nu
    of = {s.name: v for s, v in zip(network.segments, vessels, strict=True)}
    after = {j.inflow[0]: [of[name] for name in j.outflow] for j in network.junctions}
    behind = [after.get(s.name, []) for s in network.segments]
    names = [f"{s.name}_{round(100 * x)}.{signal}" for s in network.segments for x in PLACES for signal in "PQ"]
    at = [[min(max(round(x * (v.U.shape[1] - 2)), 1), v.U.shape[1] - 2) for x in PLACES] for v in vessels]
    times, rows = list[float](), list[list[float]]()
    while t <= until:
        dt = cfl * min(v.dx / np.max(np.abs(v.U[1] / v.U[0] + v.k * v.U[0] ** 0.25)) for v in vessels)
        vessels[0].U[1, 1] = network.inlet.Q(np.array([t]))[0]
        for i, v in enumerate(vessels):
            advance(v, dt, friction, slopes)
            if behind[i]:
                meet(v, behind[i], network.fluid.rho)
            if v.load is not None:
                leave(v, dt)
        for v in vessels:
            v.U[:, 0], v.U[:, -1] = v.U[:, 1], v.U[:, -2]
        if t > until - 1.01 * T:
            times.append(t)
            rows.append(
                [y for v, n in zip(vessels, at, strict=True) for j in n for y in (v.pressure(v.U[0, j]), v.U[1, j])]
            )
        t += dt
    columns = dict(zip(names, np.array(rows).T, strict=True))
    return Waveforms(np.array(times), columns, dict.fromkeys(names, ""), round(until / T), np.nan)


def own(network: Network, until: float) -> Waveforms:
    """This solver's beat of the same time, from rest."""
    return last_beat(with_sites(network), Settings(dt=2e-3), until)


SWITCHES: dict[str, Callable[[Network, float], Waveforms]] = {
    "this solver": own,
    "openBF's method": simulated,
    "slopes: van Albada": lambda n, until: simulated(n, until, slopes=van_albada),
    "CFL number: 0.45": lambda n, until: simulated(n, until, cfl=0.45),
    "cells: 0.5 mm": lambda n, until: simulated(n, until, cell=5e-4),
}


def main(
    data: Annotated[Path | None, typer.Option(help="openBF's results, a directory per network.")] = None,
    networks: Annotated[str, typer.Option(help="Names, with commas: cca, ibif, or files.")] = "ibif",
    figure: Annotated[Path | None, typer.Option(help="Draw the differences of the flow in the first here.")] = None,
    switch_all: Annotated[bool, typer.Option("--switch/--no-switch", help="Switch parts of the method.")] = True,
) -> None:
    """Compare the method, and its variants, with openBF's results."""
    for i, name in enumerate(networks.split(",")):
        network, results = load(name), dict[str, Waveforms]()
        found = {key: x for key, x in reference(network, data).items() if key[-1] in "PQ"}
        for label, run in list(SWITCHES.items())[: None if switch_all else 2]:
            results[label] = run(network, max(t[-1] for t, _ in found.values()))
        tabulate_errors(network, {label: compared(result, found) for label, result in results.items()})
        if i == 0 and figure is not None:
            draw(results, found, figure)


def draw(results: dict[str, Waveforms], found: Any, path: Path) -> None:
    """How far from this solver's flow openBF's is, and its method's, where the shape differs most in each vessel."""
    import matplotlib.pyplot as plt

    ours = results["this solver"]
    errors = {key: e[0] for key, e in compared(ours, found).items() if key.endswith(".Q")}
    vessels = dict.fromkeys(key.split("_")[0] for key in errors)
    keys = [max((key for key in errors if key.startswith(v)), key=lambda key: errors[key]) for v in vessels]
    figure, axes = plt.subplots(1, min(2, len(keys)), figsize=(9.0, 3.4), squeeze=False, layout="constrained")
    lines = (
        ("openBF's method", "#D55E00", "-"),
        ("slopes: van Albada", "#009E73", ":"),
        ("cells: 0.5 mm", "#0072B2", "--"),
    )
    for axis, key in zip(axes[0], keys, strict=False):
        t, wanted = found[key]
        size = 0.01 * np.ptp(wanted)
        axis.plot(t, (wanted - np.interp(t, ours.time, ours[key])) / size, "o", color="0.5", mfc="none", label="openBF")
        for label, colour, style in (line for line in lines if line[0] in results):
            difference = np.interp(ours.time, results[label].time, results[label][key]) - ours[key]
            axis.plot(ours.time, difference / size, color=colour, linestyle=style, label=label)
        axis.set(title=f"Q, {key[:-2].replace('_', ', ')} % of its length", xlabel="t [s]")
    axes[0][0].set_ylabel("less this solver's, % of pulse")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    start(main)
