"""The network file of a first model: readable values, each with its origin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.laws.outlets import Windkessel
from solver.network.description import Network, Segment
from solver.quantities.quantity import quantities
from solver.quantities.text import quoted, typed_unit
from solver.quantities.units import INFLOW, display_factor, display_units, readable

from .estimates import FirstEstimate
from .fitted import of_owner
from .tubes import TAPERED, Array, Tube

REFERENCE = "first model of "  # how the reference of such a file begins
_LARGE = 0.3  # larger relative standard deviations are given as factors


@dataclass(frozen=True)
class ModelSource:
    """The source of a first model: file name and hash of the record, species ("": not stated) and source of its typical
    aorta, period [s], mean pressure at the root and venous pressure [Pa], site at the root ("": the inlet), harmonics
    of the inflow Q : (K+1,) [m³/s]."""

    record: str
    sha256: str
    like: str
    typical: str
    T: float
    P: float
    P_venous: float
    root: str
    Q: Array


def value(found: FirstEstimate) -> str:
    """The number in its display unit: "0.965 mmHg·s/mL"."""
    unit, factor = readable(found.unit)
    return f"{factor * found.value:.3g} {unit}".strip()


def error(found: FirstEstimate) -> str:
    """Its standard deviation: "± 12 %", or a factor where it is large."""
    return f"± {100.0 * found.error:.2g} %" if found.error < _LARGE else f"×/÷ {np.exp(found.error):.2g}"


def network_file(
    source: ModelSource,
    found: Iterable[FirstEstimate],
    tubes: Sequence[Tube],
    windkessels: Mapping[str, tuple[float, ...]],
    notes: Iterable[str],
    factor: Mapping[str, float],
    late: float,
) -> str:
    """TOML with all of it. windkessels : R1, C, R2 by section [SI]. factor : of the fit, by parameter. late : of the
    inflow [s], as a comment."""
    lines = [*_head(source, found, notes), *_inlet(source, tubes[0].section.name)]
    for tube in tubes:
        lines += _segment(tube, factor)
    lines += _junctions(tubes)
    for name, numbers in windkessels.items():
        lines += _outlet(name, numbers, source.P_venous, factor)
    lines += _sites(source.root, tubes)
    if late:
        lines += ["", f'# [channels."{INFLOW}"]  # remove the signs # in front to keep the delay in the model']
        lines += [f'# delay = "{1e3 * late:.3g} ms"']
    return "\n".join(lines) + "\n"


def _head(source: ModelSource, found: Iterable[FirstEstimate], notes: Iterable[str]) -> list[str]:
    """Comments, texts and numbers of the whole network."""
    P_ref = (source.P, "mean pressure at the root: R0 and E are those of that pressure")
    return [
        f"# A first model of {source.record}, for editing: the start of a calibration, not its result.",
        "# Estimates from the recording, with one standard deviation and the method:",
        *(f"#   {each.name} = {value(each)} {error(each)}: {each.how}" for each in found),
        f"# Not from the recording: thickness of the walls, from {source.typical}.",
        "# Lengths, walls and Windkessels were then fitted to the mean beat, as small waves, from these estimates.",
        *(f"# Doubtful: {note}" for note in notes),
        "",
        'name = "first"',
        *([f'species = "{source.like}"'] if source.like else []),
        f'reference = "{REFERENCE}{source.record}, sha256 {source.sha256[:16]}"',
        "",
        "[network]",
        *_lines(Network, {}, P_ref=P_ref, P_0=(source.P, "start there")),
    ]


def _inlet(source: ModelSource, segment: str) -> list[str]:
    return [
        "",
        "[inlet]  # the mean beat of inlet.Q, by its harmonics [m^3/s]",
        f'segment = "{segment}"',
        f'T = "{source.T:.15g} s"',
        f"Q_mean = {source.Q[0].real:.5g}",
        f"Q_cos = [{', '.join(f'{x:.4g}' for x in 2.0 * source.Q[1:].real)}]",
        f"Q_sin = [{', '.join(f'{x:.4g}' for x in -2.0 * source.Q[1:].imag)}]",
    ]


def _segment(tube: Tube, factor: Mapping[str, float]) -> list[str]:
    s = tube.section
    fit = of_owner(factor, s.name)
    numbers = _lines(
        Segment,
        fit,
        L=(tube.L, "wave speed times that time"),
        R0=(tube.R0, "at the middle, from c and Z_c over its share of the flow"),
        h=(tube.h, "a typical fraction of R0"),
        E=(tube.E, "from c, R0 and h; the recording determines only E h"),
        phi0=(tube.phi0, "a typical fraction of E"),
    )
    by_fit = ", by the fit" if TAPERED in fit else ""
    taper = f"{TAPERED} = {round(tube.taper, 4) + 0.0:g}  # of R0 over the length, typical of arteries{by_fit}"
    return ["", f"[segments.{s.name}]  # {s.share:.0%} of the flow, {1e3 * s.time:.3g} ms long", *numbers, taper]


def _junctions(tubes: Sequence[Tube]) -> list[str]:
    parents = dict.fromkeys(tube.section.parent for tube in tubes if tube.section.parent)
    lines = []
    for parent in parents:
        children = tuple(tube.section.name for tube in tubes if tube.section.parent == parent)
        lines += ["", "[[junctions]]", f'in = ["{parent}"]', f"out = {quoted(children)}"]
    return lines


def _outlet(name: str, numbers: tuple[float, ...], P_venous: float, factor: Mapping[str, float]) -> list[str]:
    R1, C, R2 = numbers
    written = _lines(
        Windkessel,
        of_owner(factor, f"{name}.outlet"),
        R1=(R1, "the impedance of the tube: no reflection of steep waves"),
        C=(C, "its share of the compliance outside the tubes"),
        R2=(R2, "the rest of its share of the resistance"),
        P_venous=(P_venous, "given, not estimated"),
    )
    return ["", f"[outlets.{name}]", *written]


def _sites(root: str, tubes: Sequence[Tube]) -> list[str]:
    places = [(root, tubes[0].section.name, 0.0)] if root else []
    places += [(tube.section.site, tube.section.name, 1.0) for tube in tubes if tube.section.site]
    texts = (f'{site} = {{ segment = "{segment}", position = {at:g} }}' for site, segment, at in places)
    return ["", "[sites]", *texts]


def _lines(kind: Any, factor: Mapping[str, float], **rows: tuple[float, str]) -> list[str]:
    """Lines of a section of the file by key: a number [SI] in the unit that people read it in, and a comment with the
    factor of the fit."""
    known, lines = quantities(kind), []
    for key, (x, estimated) in rows.items():
        comment = f"{estimated}, × {factor[key]:.2g} by the fit" if key in factor else estimated
        display = known[key].display or display_units(known[key].unit)[0]
        lines.append(f'{key} = "{display_factor(display) * x:.4g} {typed_unit(display)}"  # {comment}')
    return lines
