"""What the FMUs of this project are made of: arteries, hearts and bodies. Not part of their code."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from solver.errors import InputError
from solver.laws import effects
from solver.laws.catalogue import quantities_of
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.lumped.body import Body
from solver.lumped.heart_parts import Heart
from solver.lumped.species import SPECIES
from solver.network.description import Network, to_dict
from solver.network.files import dumps
from solver.scheme.model import Settings

from .. import __version__
from ..cosimulation.drive import inlet_with, own_drive
from ..documents import document
from ..slaves import body_slave, heart_slave
from ..slaves.base import ComponentSlave, Subject
from ..variables.arteries_variables import variable_table
from ..variables.variable import Variable, with_starts

Starts = Mapping[str, float | str]
Table = tuple[Variable, ...]

_LAWS = ("elastic_law", "viscous_law")  # of a network that are variables, beside its parameters
_STEPS = ("dt", "element_length")  # of the settings that are variables


@dataclass(frozen=True)
class FMUContents:
    """The contents of one FMU.

    name : of the model and of the file. slave, kind : the module in ``fmu_src`` and its class. table : its variables.
    resources, documents : further files by path, text in ``resources/`` and bytes in the whole archive. subject : the
    object that the slave of a heart or body makes of the resources. fmi : version of the standard that their documents
    are for, 0 where the FMU needs Python.
    """

    name: str
    slave: str
    kind: str
    table: tuple[Variable, ...]
    resources: dict[str, str]
    documents: dict[str, bytes]
    subject: Subject | None = None
    fmi: int = 0


def arteries_model(network: Network, settings: Settings, starts: Starts | None = None) -> FMUContents:
    """Arteries; starts : other start values than those of the network, by variable.

    Raises ValueError as :func:`given_arteries`, and for a network that needs more code than the solver's.
    """
    _check_code(network)
    network, settings, table, others = given_arteries(network, settings, starts or {})
    data = {"settings": asdict(settings), "network": to_dict(network)}
    resources = {**_data("network.json", data, others), "network.toml": dumps(network)}
    documents = document.documents(network, table, __version__)
    return FMUContents(network.name, "slaves.arteries_slave", "ArterialSlave", table, resources, documents)


def given_arteries(network: Network, settings: Settings, given: Starts) -> tuple[Network, Settings, Table, Starts]:
    """Network and settings with the start values that they hold, so that everybody who opens the FMU finds the same
    values; the table of variables, and the start values that are its alone. Raises ValueError for one that is not
    allowed."""
    with_starts(variable_table(network, settings), given)  # rejects names and values
    network, settings = _network_with(network, given), _settings_with(settings, given)
    table, others = _others(variable_table(network, settings), given)
    if "network" in (variable.start for variable in table if variable.name == "inlet.drive"):
        own_drive(network, given)  # raises where there is none
    return network, settings, table, others


def heart_model(species: str = "human", starts: Starts | None = None, fmi: int = 0) -> FMUContents:
    """A left heart. fmi : version of the standard of a model that needs no Python, 0 of others.

    Raises ValueError for an unknown species.
    """
    title = "The left heart: ventricle and atrium of time-varying elastance, two valves."
    uses = document.HEART_USES
    return _lumped(of(species)[0], "heart", heart_slave.HeartSlave, heart_slave.table, title, uses, starts or {}, fmi)


def body_model(species: str = "human", starts: Starts | None = None, fmi: int = 0) -> FMUContents:
    """The veins, the right heart and the lungs. fmi : as of hearts. Raises ValueError for an unknown species."""
    title = "The veins, the right heart and the lungs as one elastic reservoir."
    uses = document.BODY_USES
    return _lumped(of(species)[1], "body", body_slave.BodySlave, body_slave.table, title, uses, starts or {}, fmi)


def _lumped(
    part: Heart | Body, kind: str, slave: type[ComponentSlave], variables: Callable[..., Table], title: str,
    uses: tuple[str, ...], starts: Starts, fmi: int,
) -> FMUContents:  # fmt: skip
    """A heart or a body with these start values. variables : the table of one. uses : of the page."""
    with_starts(variables(part), starts)  # rejects names and values
    part = part.with_values(starts)
    table, others = _others(variables(part), starts)
    pages = document.lumped_documents(part.name, title, part.reference, uses, table, fmi)
    resources = _data(slave.data_file, {kind: asdict(part)}, others)
    subject = slave.subject(json.loads(resources[slave.data_file]))
    return FMUContents(part.name, f"slaves.{kind}_slave", slave.__name__, table, resources, pages, subject, fmi)


def of(species: str) -> tuple[Heart, Body]:
    """The heart and the body of a species. Raises ValueError for an unknown one."""
    if species not in SPECIES:
        raise InputError(f"species {species!r}: there is none of this name; use one of {', '.join(SPECIES)}.")
    return SPECIES[species]


def _check_code(network: Network) -> None:
    """Raise ValueError where an effect, outlet or law is a class from elsewhere: an FMU carries the solver's alone."""
    owners = [*network.owners(), *((channel.name, channel) for channel in network.channels)]
    used: list[tuple[str, Any, str]] = [
        (f"{prefix}.{key}", effect, "solver/laws/effects.py")
        for prefix, owner in owners
        for effect in effects.ALL
        for key in effect.terms
        if effect.owner == owner.OWNER and key in quantities_of(owner)
    ]
    used += [(f"{outlet.segment}.outlet", outlet, "solver/laws/outlets.py") for outlet in network.outlets]
    used += [("network.elastic_law", ELASTIC_LAWS[network.elastic_law], "solver/laws/wall_laws.py")]
    used += [("network.viscous_law", VISCOUS_LAWS[network.viscous_law], "solver/laws/wall_laws.py")]
    for name, value, home in used:
        kind = type(value)
        if kind.__module__.partition(".")[0] != "solver":
            raise InputError(
                f"{name}: its class {kind.__name__} is in {kind.__module__}, and this FMU carries only the code of the "
                f"package solver; move the class and its entry into {home}, or leave {name} out, and build again; or "
                "build the native FMU (build_native), which needs no class."
            )


def _network_with(network: Network, starts: Starts) -> Network:
    """The network with its own parameters, laws, and means and period of what is given at its inlets."""
    known = network.parameters()
    laws: dict[str, Any] = {key: starts[f"network.{key}"] for key in _LAWS if f"network.{key}" in starts}
    first, *further = (inlet_with(inlet, starts) for inlet in network.inlets)
    changed = network.with_parameters({name: float(value) for name, value in starts.items() if name in known})
    return replace(changed, inlet=first, further_inlets=tuple(further), **laws)


def _settings_with(settings: Settings, starts: Starts) -> Settings:
    given: dict[str, Any] = {key: starts[f"solver.{key}"] for key in _STEPS if f"solver.{key}" in starts}
    return replace(settings, **given)


def _others(table: Table, starts: Starts) -> tuple[Table, dict[str, float | str]]:
    """The table with the start values that it has not yet, and these."""
    had = {variable.name: variable.start for variable in table}
    others = {name: value for name, value in starts.items() if value != had[name]}
    return with_starts(table, others), others


def _data(file: str, content: dict[str, Any], starts: Starts) -> dict[str, str]:
    whole = {"version": __version__, **content, "starts": dict(starts)}
    return {file: json.dumps(whole, indent=1, ensure_ascii=False)}
