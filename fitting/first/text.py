"""The network file of a first model: readable values, each with its origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solver.laws.outlets import Windkessel
from solver.network.description import Network, Segment
from solver.quantities.quantity import quantities
from solver.quantities.text import quoted, typed_unit
from solver.quantities.units import INFLOW, display_factor, display_units, readable

from .doubts import late_flow, undivided
from .estimates import FirstEstimate
from .fitted import Delay, Fitted, of_owner
from .options import REFERENCE
from .tubes import KEYS, TAPERED, Array, Tube

_LARGE = 0.3  # larger relative standard deviations are given as factors


def value(found: FirstEstimate) -> str:
    """The number in its display unit: "0.965 mmHg·s/mL"."""
    unit, factor = readable(found.unit)
    return f"{factor * found.value:.3g} {unit}".strip()


def error(found: FirstEstimate) -> str:
    """Its standard deviation: "± 12 %", or a factor where it is large."""
    return f"± {100.0 * found.error:.2g} %" if found.error < _LARGE else f"×/÷ {np.exp(found.error):.2g}"


@dataclass(frozen=True)
class ModelFile:
    """The contents of the file of a first model.

    record, sha256 : name and hash of the recording. like : species, "" if it is not stated; typical : source of its
    aorta. T : period [s]. P, P_venous : mean pressure at the root and venous pressure [Pa]. root : site there, "" for
    the inlet. Q : (K+1,) harmonics of the inflow [m³/s]. windkessels : R1, C, R2 by section [SI]. factor : of the fit,
    by parameter. late : of the inflow [s], as a comment.
    """

    record: str
    sha256: str
    like: str
    typical: str
    T: float
    P: float
    P_venous: float
    root: str
    Q: Array
    found: tuple[FirstEstimate, ...]
    tubes: Sequence[Tube]
    windkessels: Mapping[str, tuple[float, ...]]
    notes: Sequence[str]
    factor: Mapping[str, float] = field(default_factory=dict)
    late: float = 0.0

    def __str__(self) -> str:
        """TOML with all of it."""
        lines = [*_head(self), *_inlet(self)]
        for tube in self.tubes:
            lines += _segment(tube, self.factor)
        lines += _junctions(self.tubes)
        for name, numbers in self.windkessels.items():
            lines += _outlet(name, numbers, self.P_venous, self.factor)
        lines += _sites(self.root, self.tubes)
        if self.late:
            lines += ["", f'# [channels."{INFLOW}"]  # remove the signs # in front to keep the delay in the model']
            lines += [f'# delay = "{1e3 * self.late:.3g} ms"']
        return "\n".join(lines) + "\n"

    def adjusted(self, fit: Fitted, delay: Delay | None, root: str) -> ModelFile:
        """The same with the fitted values, and notes on branches without flow and on a late inlet.Q."""
        f = fit.factor
        tubes = [
            replace(
                t,
                section=replace(t.section, share=t.section.share * fit.share[t.section.name]),
                **{key: getattr(t, key) * x for key, x in of_owner(f, t.section.name).items()},
            )
            for t in self.tubes
        ]
        ends = {
            name: tuple(x * of_owner(f, f"{name}.outlet").get(key, 1.0) for key, x in zip(KEYS, values, strict=True))
            for name, values in self.windkessels.items()
        }
        notes = [*self.notes, *map(undivided, fit.undivided), *([late_flow(delay, root)] if delay else [])]
        return replace(self, tubes=tubes, windkessels=ends, notes=notes, factor=f, late=delay.late if delay else 0.0)


def _head(file: ModelFile) -> list[str]:
    """Comments, texts and numbers of the whole network."""
    P_ref = (file.P, "mean pressure at the root: R0 and E are those of that pressure")
    return [
        f"# A first model of {file.record}, for editing: the start of a calibration, not its result.",
        "# Estimates from the recording, with one standard deviation and the method:",
        *(f"#   {each.name} = {value(each)} {error(each)}: {each.how}" for each in file.found),
        f"# Not from the recording: thickness of the walls, from {file.typical}.",
        "# Lengths, walls and Windkessels were then fitted to the mean beat, as small waves, from these estimates.",
        *(f"# Doubtful: {note}" for note in file.notes),
        "",
        'name = "first"',
        *([f'species = "{file.like}"'] if file.like else []),
        f'reference = "{REFERENCE}{file.record}, sha256 {file.sha256[:16]}"',
        "",
        "[network]",
        *_lines(Network, {}, P_ref=P_ref, P_0=(file.P, "start there")),
    ]


def _inlet(file: ModelFile) -> list[str]:
    return [
        "",
        "[inlet]  # the mean beat of inlet.Q, by its harmonics [m^3/s]",
        f'segment = "{file.tubes[0].section.name}"',
        f'T = "{file.T:.15g} s"',
        f"Q_mean = {file.Q[0].real:.5g}",
        f"Q_cos = [{', '.join(f'{x:.4g}' for x in 2.0 * file.Q[1:].real)}]",
        f"Q_sin = [{', '.join(f'{x:.4g}' for x in -2.0 * file.Q[1:].imag)}]",
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
