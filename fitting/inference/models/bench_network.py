"""The bench as a network: a short piece of artery under an imposed pressure; its FMU computes R from P."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from solver.errors import InputError
from solver.laws.outlets import Pressure
from solver.network.description import Inlet, Network, Segment, Site

from ...results.parameter_set import ParameterSet

LENGTH = 1e-3  # [m]; over it the pressure falls by less than a pascal, so that the radius depends on the wall alone
NEEDED = ("R0", "h", "E")


def bench_network(site: str, parameters: ParameterSet, T: float = 0.5) -> Network:
    """A segment with the name of the site, closed at the inlet, with the pressure `<site>.outlet.P_venous` at its end.

    parameters : must contain R0, h and E of the site; its other values of the site and of ``network``, and its laws,
    also apply. T : period of the default inflow (which is 0) [s]. P_ref = 0: R0 is the radius without pressure. Raises
    ValueError, one sentence, if a value is missing or not allowed.
    """
    missing = [f"{site}.{key}" for key in NEEDED if f"{site}.{key}" not in parameters.values]
    if missing:
        raise InputError(f"parameter set {parameters.name}: a bench of {site} needs {', '.join(missing)}; add it.")
    own = own_values(site, parameters)
    wall: dict[str, Any] = {
        key.removeprefix(f"{site}."): own.values[key].value for key in own.values if key.startswith(f"{site}.")
    }
    network = Network(f"bench_{site}", (Segment(site, LENGTH, **wall),), Inlet(site), outlets=(Pressure(site),))
    law = parameters.provenance.get("elastic_law", {}).get("sentence", "")
    return own.apply(on_bench(network, site, T, ", ".join(filter(None, [f"the parameter set {parameters.name}", law]))))


def on_bench(
    network: Network, site: str, T: float | None = None, source: str = "", segment: str | None = None
) -> Network:
    """A millimetre of one artery of a network, with the pressure `<site>.outlet.P_venous` at its end and no inflow.

    T : period of the default inflow (which is 0) [s]; default that of the network. source : origin, for the reference.
    segment : of the site, if it has another name.
    """
    return replace(
        network,
        name=f"bench_{site}",
        segments=(replace(network.segment(segment or site), name=site, L=LENGTH),),
        inlet=Inlet(site, Q_max=0.0, T=T or network.inlet.T),
        junctions=(),
        outlets=(Pressure(site),),
        sites=(Site(site, site),),
        channels=(),
        reference=f"One artery on the bench, from {source or f'network {network.name}'}.",
    )


def own_values(site: str, parameters: ParameterSet) -> ParameterSet:
    """The part of a set for the bench of one site: its wall without the length, eta and the laws."""
    counts = {
        name: value
        for name, value in parameters.values.items()
        if name.rpartition(".")[0] in (site, "network") and name != f"{site}.L"
    }
    return ParameterSet(parameters.name, counts, parameters.texts, parameters.provenance)
