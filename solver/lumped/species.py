"""Hearts and venous reservoirs of species, with the source of every number."""

from __future__ import annotations

from dataclasses import asdict

from ..quantities.units import MMHG
from .body import Body, Reservoir
from .heart_parts import Aorta, Chamber, Filling, Heart, Pace, Valve, Ventricle

_ML = 1e-6
_PER_ML = MMHG / _ML  # mmHg/mL, and mmHg s/mL

_KORAKIANITIS = "T. Korakianitis, Y. Shi, J. Biomech. 39, 1964 (2006), doi:10.1016/j.jbiomech.2005.06.016"

HUMAN_HEART = Heart(
    name="human_heart",
    reference=f"Chambers, their timing as parts of a beat, areas of the valves and venous resistance: {_KORAKIANITIS}. "
    "Our choice: heart rate, filling pressure; lengths and rates of the valves; the resistance of the ejecting "
    "ventricle, of the kind that J.-W. Lankhaar et al., Ann. Biomed. Eng. 37, 1710 (2009) fit to sheep after Shroff.",
    heart=Pace(rate=1.0 / 0.9),  # as network human: 67 beats a minute
    left_ventricle=Ventricle(
        2.5 * _PER_ML, 0.1 * _PER_ML, 5.0 * _ML, 1.0 * MMHG, begin=0.0, rise=0.3, fall=0.15, R=0.05 * _PER_ML
    ),
    left_atrium=Chamber(0.25 * _PER_ML, 0.15 * _PER_ML, 4.0 * _ML, 1.0 * MMHG, begin=0.92, rise=0.045, fall=0.045),
    # areas of the orifice flow Q = C sqrt(ΔP) with C = 400 and 350 mL/s/sqrt(mmHg): A = C sqrt(ρ/2)
    mitral_valve=Valve(A=7.98e-4, l=0.02, R=0.0, K_open=0.3, K_close=0.3, regurgitation=0.0),
    aortic_valve=Valve(A=6.98e-4, l=0.02, R=0.0, K_open=0.12, K_close=0.12, regurgitation=0.0),
    venous=Filling(R=0.006 * _PER_ML),
    aorta=Aorta(curvature=0.2),
    P_venous=11.2 * MMHG,
    P_aorta=80.0 * MMHG,
)
HUMAN_BODY = Body(
    name="human_body",
    reference=f"Compliance: systemic and pulmonary veins together, {_KORAKIANITIS}. Our choice: volume and pressure.",
    body=Reservoir(C=41.0 * _ML / MMHG, V_unstressed=2500.0 * _ML, P_start=11.2 * MMHG),
)

# Published values of a whole sheep heart were not found. By size: volumes and compliances as the body mass, areas as
# its power 2/3, lengths as its power 1/3; pressures as in a human. That a linear time-varying elastance describes the
# ventricle of sheep is measured: J.-W. Lankhaar et al., Ann. Biomed. Eng. 37, 1710 (2009), five sheep.
_MASS = 30.0 / 70.0  # kg, sheep to human
_SCALED = (
    "Scaled by us from the human one to a sheep of 30 kg, at the 120 beats a minute of A. R. Ghigo et al. (2017), "
    "doi:10.1115/1.4034832; human values: "
)


def _smaller(chamber: Chamber) -> Chamber:
    c = chamber
    return Chamber(c.E_max / _MASS, c.E_min / _MASS, c.V_0 * _MASS, c.P_0, c.begin, c.rise, c.fall)


def _narrower(valve: Valve) -> Valve:
    v = valve
    return Valve(v.A * _MASS ** (2 / 3), v.l * _MASS ** (1 / 3), v.R / _MASS, v.K_open, v.K_close, v.regurgitation)


SHEEP_HEART = Heart(
    name="sheep_heart",
    reference=_SCALED + HUMAN_HEART.reference,
    heart=Pace(rate=2.0),
    left_ventricle=Ventricle(**asdict(_smaller(HUMAN_HEART.left_ventricle)), R=HUMAN_HEART.left_ventricle.R / _MASS),
    left_atrium=_smaller(HUMAN_HEART.left_atrium),
    mitral_valve=_narrower(HUMAN_HEART.mitral_valve),
    aortic_valve=_narrower(HUMAN_HEART.aortic_valve),
    venous=Filling(R=HUMAN_HEART.venous.R / _MASS),
    aorta=HUMAN_HEART.aorta,
    P_venous=HUMAN_HEART.P_venous,
    P_aorta=HUMAN_HEART.P_aorta,
)
SHEEP_BODY = Body(
    name="sheep_body",
    reference=_SCALED + HUMAN_BODY.reference,
    body=Reservoir(
        C=HUMAN_BODY.body.C * _MASS, V_unstressed=HUMAN_BODY.body.V_unstressed * _MASS, P_start=HUMAN_BODY.body.P_start
    ),
)

SPECIES = {"human": (HUMAN_HEART, HUMAN_BODY), "sheep": (SHEEP_HEART, SHEEP_BODY)}
