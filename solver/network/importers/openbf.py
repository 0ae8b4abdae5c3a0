"""Networks of openBF (A. Melis, Gaussian process emulators for 1D vascular models, PhD thesis, Sheffield 2017;
https://github.com/INSIGNEO/openBF): YAML in SI units, the inflow in a table of two columns.

openBF solves P = Pext + E h/((1 - σ²) R0) (√(A/A0) - 1) with σ = 1/2, α = 1 and the friction 2 (γ + 2) π ν of the
velocity profile 1 - (r/R)^γ; it interpolates the inflow linearly. A vessel without h0 has the thickness
(Olufsen 1999, as in Boileau et al. 2015)

    h = R0 (0.2802 e^{-505.3 R0/m} + 0.1324 e^{-11.14 R0/m})

With R1 and Cc but without R2, R1 is the total resistance; the impedance ρ c0/A0 of the vessel's end is subtracted from
it and placed before the compliance, so that waves are not reflected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...quantities.quantity import Quantity, quantities
from ...quantities.text import check_keys, read_text
from ..description import Fluid, Segment
from .sections import Edge, Sections, joined, names

ETA = 0.5
_TOP = ("project_name", "network", "blood", "inlet_file", "solver", "write_results", "output_directory")
_BLOOD = ("rho", "mu")
# the last seven belong to openBF's numerics and output, or to its start, which does not affect periodic beats
_VESSEL = (
    *("label", "sn", "tn", "L", "E", "R0", "Rp", "Rd", "h0", "Pext", "gamma_profile", "gamma profile", "visco-elastic"),
    *("outlet", "Rt", "R1", "R2", "Cc", "Pout", "inlet_impedance_matching"),
    *("M", "to_save", "initial_flow", "initial_pressure"),
)
_OUTLETS = ("reflection", "wk2", "wk3", "none")


def read_openbf(path: str | Path, *, as_run: bool = False) -> Sections:
    """The sections of a network in openBF's format.

    as_run : import what openBF 2 computes, according to its source, where that differs from the file: radii are those
    of the proximal ends, R1 without R2 keeps its full value beside R2 = R1 - ρ c0/A0, "gamma profile", without the
    underscore, is ignored (γ = 2), and a junction of two vessels conserves the total pressure.
    Raises ValueError, one sentence with the file and the line, the vessel or the key.
    """
    path = Path(path)
    text = read_text(path)
    try:
        return _sections(_parsed(text), path, as_run)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _parsed(text: str) -> Mapping[str, Any]:
    try:
        import yaml
    except ImportError:
        raise InputError("reading YAML needs PyYAML, which is not installed; pip install pyyaml.") from None

    class Loader(yaml.SafeLoader):
        """YAML silently keeps the last of two equal keys; here they are an error."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            names = [self.construct_object(key, deep=True) for key, _ in node.value]
            for i, (key, _) in enumerate(node.value):
                if names[i] in names[:i]:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {names[i]} occurs twice", key.start_mark
                    )
            return super().construct_mapping(node, deep)

    try:
        data = yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date that is none
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", error)).split())
        raise InputError(f"not valid YAML{line} ({reason}); correct it.") from None
    except RecursionError:
        raise InputError("not a network of openBF: it is nested too deeply; correct it.") from None
    return _mapping(data, "top level")


def _sections(data: Mapping[str, Any], path: Path, as_run: bool) -> Sections:
    check_keys("top level", data, _TOP)
    blood = _mapping(data.get("blood"), "blood")
    check_keys("blood", blood, _BLOOD)
    rho, mu = _number(blood, "rho", "blood", allowed=quantities(Fluid)["rho"]), _number(blood, "mu", "blood")
    vessels = data.get("network")
    if not isinstance(vessels, list) or not vessels:
        raise InputError("network: must be a list of vessels, each with label, sn, tn, L, E and R0; add it.")
    vessels = [_mapping(vessel, f"vessel {n}") for n, vessel in enumerate(vessels, 1)]
    for n, vessel in enumerate(vessels, 1):
        for key in ("label", "sn", "tn"):
            if key not in vessel:
                raise InputError(f"vessel {n}: the key {key} is missing; add it.")
            if not isinstance(vessel[key], str | int) or isinstance(vessel[key], bool):
                raise InputError(f"vessel {n}: {key} = {vessel[key]!r} must be a number or text; correct it.")
        check_keys(f"vessel {vessel['label']}", vessel, _VESSEL)
        if vessel.get("visco-elastic", False):
            raise InputError(f"vessel {vessel['label']}: visco-elastic cannot be imported; give C_v in the TOML file.")
    labels = names([str(vessel["label"]) for vessel in vessels])
    edges = [
        Edge(name, str(v["sn"]), str(v["tn"]), f"vessel {v['label']}") for name, v in zip(labels, vessels, strict=True)
    ]
    first, junctions, free = joined(edges)
    if as_run:  # at bifurcations it conserves the static pressure, as this solver does
        junctions = [j | ({"k": 1.0} if len(j["in"]) == len(j["out"]) == 1 else {}) for j in junctions]
    project = str(_text(data, "project_name", path.stem))
    times, flows = _inflow(path.parent / str(_text(data, "inlet_file", f"{project}_inlet.dat")))
    exponent = _exponent(vessels, as_run)
    pressures = [_number(v, "Pext", f"vessel {v['label']}", 0.0) for v in vessels]
    common = pressures[0] if len(set(pressures)) == 1 else 0.0
    segments, outlets = {}, {}
    for name, vessel, P in zip(labels, vessels, pressures, strict=True):
        segments[name] = _segment(vessel, as_run) | ({"P_ext": f"{P!r} Pa"} if P != common else {})
        if name in free:
            outlets[name] = _outlet(vessel, rho, as_run)
        elif used := [key for key in ("R1", "R2", "Cc", "Rt", "Pout") if key in vessel]:
            raise InputError(f"vessel {vessel['label']}: {used[0]} belongs to a vessel that ends; remove it.")
    return {
        "name": names([project])[0],
        "reference": "",
        "network": {"eta": ETA, "P_ref": f"{common!r} Pa", "P_0": f"{common!r} Pa"},
        "fluid": {"rho": f"{rho!r} kg/m^3", "mu": f"{mu!r} Pa*s", "alpha": 1, "friction": 2.0 * (exponent + 2.0)},
        "inlet": {"segment": first, "t": times, "Q": flows, "interpolation": "linear"},
        "segments": segments,
        "junctions": junctions,
        "outlets": outlets,
    }


def _exponent(vessels: list[Mapping[str, Any]], as_run: bool) -> float:
    """γ of the velocity profile, which must be the same in all vessels."""
    keys = ("gamma_profile",) if as_run else ("gamma_profile", "gamma profile")
    found = {
        next((_number(v, key, f"vessel {v['label']}") for key in keys if key in v), 2.0): v["label"] for v in vessels
    }
    if len(found) > 1:
        exponents = " and ".join(f"{exponent:g} in {label}" for exponent, label in list(found.items())[:2])
        raise InputError(f"gamma_profile: {exponents}; all vessels must have one velocity profile, so choose one.")
    return next(iter(found))


def _radii(vessel: Mapping[str, Any], as_run: bool) -> tuple[float, float]:
    """The radii at the proximal and the distal end [m]."""
    where = f"vessel {vessel['label']}"
    if "R0" not in vessel and "Rp" not in vessel:
        raise InputError(f"{where}: it has no radius; give R0, or Rp and Rd.")
    allowed = quantities(Segment)["R0"]
    proximal = _number(vessel, "Rp" if "Rp" in vessel else "R0", where, allowed=allowed)
    return proximal, proximal if as_run else _number(vessel, "Rd", where, proximal, allowed)


def _thickness(vessel: Mapping[str, Any], R: float) -> float:
    if "h0" in vessel:
        return _number(vessel, "h0", f"vessel {vessel['label']}", allowed=quantities(Segment)["h"])
    return float(f"{R * (0.2802 * math.exp(-505.3 * R) + 0.1324 * math.exp(-11.14 * R)):.8g}")


def _segment(vessel: Mapping[str, Any], as_run: bool) -> dict[str, Any]:
    where = f"vessel {vessel['label']}"

    def both(a: float, b: float) -> Any:
        return f"{a!r} m" if a == b else [f"{a!r} m", f"{b!r} m"]

    R = _radii(vessel, as_run)
    return {
        "L": f"{_number(vessel, 'L', where, allowed=quantities(Segment)['L'])!r} m",
        "R0": both(*R),
        "h": both(*(_thickness(vessel, each) for each in R)),
        "E": f"{_number(vessel, 'E', where, allowed=quantities(Segment)['E'])!r} Pa",
    }


def _outlet(vessel: Mapping[str, Any], rho: float, as_run: bool) -> dict[str, Any]:
    where, kind = f"vessel {vessel['label']}", vessel.get("outlet")
    if kind is not None and kind not in _OUTLETS:
        raise InputError(f"{where}: outlet = {kind!r} cannot be imported; use one of {', '.join(_OUTLETS)}.")
    given = [key for key in ("R1", "R2", "Cc") if key in vessel]
    if bool(given) != (kind in ("wk2", "wk3")) and kind is not None:
        raise InputError(
            f"{where}: outlet = {kind!r} with {', '.join(given) or 'neither R1 nor Cc'}; correct one of them."
        )
    if not given:
        return {"R_t": _number(vessel, "Rt", where, 0.0)}
    R1, C = _number(vessel, "R1", where), _number(vessel, "Cc", where)
    R2, matched = _number(vessel, "R2", where, 0.0), bool(vessel.get("inlet_impedance_matching", False))
    if R2 == 0.0 or matched:
        R = _radii(vessel, as_run)[1]
        stiffness = _number(vessel, "E", where) * _thickness(vessel, R) / ((1.0 - ETA**2) * R)
        Z = math.sqrt(rho * stiffness / 2.0) / (math.pi * R**2)  # ρ c0/A0
        R2 = R1 + R2 - Z
        R1 = R1 if as_run and not matched else Z
        if not R2 > 0.0:
            raise InputError(f"{where}: R1 does not exceed the impedance {Z:.4g} Pa s/m^3 of its end; check R1.")
        R1, R2 = (float(f"{each:.8g}") for each in (R1, R2))
    texts = {"R1": f"{R1!r} Pa*s/m^3", "C": f"{C!r} m^3/Pa", "R2": f"{R2!r} Pa*s/m^3"}
    P = _number(vessel, "Pout", where, 0.0)
    return texts | ({"P_venous": f"{P!r} Pa"} if P else {})


def _inflow(path: Path) -> tuple[list[float], list[float]]:
    """Times [s] and flows [m³/s] of a table of two columns, sorted by time: digitised curves can run backwards."""
    rows = []
    for n, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            t, Q = map(float, line.split())
        except ValueError:
            t = Q = math.nan
        if not (math.isfinite(t) and math.isfinite(Q)):
            raise InputError(f"{path}, line {n}: must hold a time and a flow, but is {line.strip()!r}; correct it.")
        rows.append((t, Q))
    rows.sort()
    return [t for t, _ in rows], [Q for _, Q in rows]


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where}: must be keys with values, not {value!r}; see openBF's documentation.")
    return {str(key): each for key, each in value.items()}


def _text(table: Mapping[str, Any], key: str, otherwise: str) -> str | int:
    """Text, or a number in its place."""
    value = table.get(key, otherwise)
    if not isinstance(value, str | int) or isinstance(value, bool) or value == "":
        raise InputError(f"{key} = {value!r} must be text; correct it, or leave it out.")
    return value


def _number(
    table: Mapping[str, Any], key: str, where: str, otherwise: float | None = None, allowed: Quantity | None = None
) -> float:
    if key not in table and otherwise is not None:
        return otherwise
    if key not in table:
        raise InputError(f"{where}: the key {key} is missing; add it.")
    value = table[key]
    try:
        found = float(value)  # YAML's 1e-13, without a dot, is text
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found) or isinstance(value, bool):
        raise InputError(f"{where}: {key} = {value!r} must be a number in SI units; correct it.")
    if allowed is not None:
        allowed.check(f"{where}: {key}", found)
    return found
