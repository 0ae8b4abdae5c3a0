"""Heart, arteries and body coupled in Python, by the two kinds of master, without FMI."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from fmus import Instance

from fmu_src.contents.system import start_values
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.cosimulation.ports import INLET_PORTS
from fmu_src.slaves import body_slave, heart_slave
from fmu_src.variables.arteries_variables import variable_table
from fmu_src.variables.variable import Variable, with_starts
from solver import Network, Settings
from solver.lumped.body import BodyComponent
from solver.lumped.heart import OUTPUTS, HeartComponent
from solver.lumped.heart_parts import Heart
from solver.lumped.species import HUMAN_BODY, HUMAN_HEART

Array = np.ndarray

VOLUMES = ("heart.left_ventricle.V", "heart.left_atrium.V", "arteries.network.V", "body.V")


@dataclass(frozen=True)
class Run:
    """What a run gave: time : (n,) [s], and the outputs after each step by ``<component>.<variable>`` : (n,)."""

    time: Array
    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    @property
    def total(self) -> Array:
        """The volume of blood [m³]."""
        return np.sum([self.values[name] for name in VOLUMES], axis=0)


class NativeArteries:
    """The arteries by an instance of their native FMU, with the calls of :class:`CoSimulation`: the same numbers
    (test_native_system.py), to 2e-11 of the pulse, in less time."""

    def __init__(self, instance: Instance, network: Network) -> None:
        self._instance = instance
        self._shown = [v.name for v in variable_table(network, Settings()) if v.causality == "output" and not v.late]
        self.venous = [name for name in instance.references if name.endswith(".P_venous")]

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        self._instance.initialize(values, t0)

    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        self._instance.set({name: values[name] for name in ("inlet.Q", *self.venous)})
        self._instance.slave.doStep(t, h)

    def outputs(self) -> list[float]:
        return self._instance.get(self._shown)

    def ports(self) -> dict[str, float]:
        names = [f"inlet.{key}" for key in INLET_PORTS["flow"]]
        return dict(zip(names, self._instance.get(names), strict=True))


def loop(
    network: Network,
    h: float,
    stop_time: float,
    *,
    parallel: bool = False,
    port: bool = True,
    heart: Heart = HUMAN_HEART,
    dt: float = 1e-3,
    element_length: float | None = None,
    starts: Mapping[str, Mapping[str, Any]] | None = None,
    every: int = 1,
    arteries: Callable[[Network, Settings], Any] = CoSimulation,
) -> Run:
    """Run the closed loop with communication steps of h [s].

    parallel : all components side by side, with what the others had at the start of the step; else heart, arteries,
    body one after the other. port : whether the heart solves P = P_0 + Z Q with the arteries, or takes their pressure
    as it was. every : of how many steps one is kept. arteries : makes their component.
    """
    settings = Settings(dt=min(dt, h)) if element_length is None else Settings(min(dt, h), element_length)
    given = start_values(network, heart, HUMAN_BODY, parallel)
    parts: dict[str, tuple[Any, tuple[Variable, ...]]] = {
        "heart": (HeartComponent(heart), heart_slave.table(heart)),
        "arteries": (arteries(network, settings), variable_table(network, settings)),
        "body": (BodyComponent(HUMAN_BODY), body_slave.table(HUMAN_BODY)),
    }
    values: dict[str, dict[str, Any]] = {}
    names: dict[str, list[str]] = {}
    for name, (component, table) in parts.items():
        table = with_starts(table, {**given[name], **(starts or {}).get(name, {})})
        values[name] = {v.name: v.start for v in table if v.start is not None}
        names[name] = [v.name for v in table if v.causality == "output" and not v.late]
        component.initialize(0.0, values[name])
    (H, A, B), (h_in, a_in, b_in) = (part[0] for part in parts.values()), values.values()
    flow, inlet, left = (
        OUTPUTS.index("aorta.Q"),
        names["arteries"].index("inlet.P"),
        names["arteries"].index("venous.V"),
    )
    n, rows, kept = round(stop_time / h), [], []
    for i in range(n):
        t = i * h
        if port:
            ports = A.ports()
            h_in |= {f"aorta.{key}": ports[f"inlet.{key}"] for key in INLET_PORTS["flow"]}
        else:
            h_in |= {"aorta.P_0": A.outputs()[inlet], "aorta.Z": 0.0, "aorta.Z_0": 0.0}
        h_in["venous.P"] = B.outputs()[0]
        if parallel:
            a_in |= {"inlet.Q": H.outputs()[flow], **dict.fromkeys(A.venous, B.outputs()[0])}
            b_in |= {"arteries.V": A.outputs()[left], "heart.V": H.state.taken}
            for component, inputs in ((H, h_in), (A, a_in), (B, b_in)):
                component.step(t, h, inputs)
        else:
            H.step(t, h, h_in)
            A.step(t, h, a_in | {"inlet.Q": H.outputs()[flow], **dict.fromkeys(A.venous, B.outputs()[0])})
            B.step(t, h, b_in | {"arteries.V": A.outputs()[left], "heart.V": H.state.taken})
        if (i + 1) % every == 0:
            rows.append([*H.outputs(), *A.outputs(), *B.outputs()])
            kept.append(t + h)
    columns = [f"{part}.{name}" for part, each in names.items() for name in each]
    return Run(np.array(kept), dict(zip(columns, np.array(rows).T, strict=True)))
