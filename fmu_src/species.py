"""Hearts and venous reservoirs of species, with the source of every number."""

from __future__ import annotations

from solver.units import MMHG

from .body import Body, Reservoir
from .heart import Chamber, Filling, Heart, Pace, Valve

_ML = 1e-6
_E = MMHG / _ML  # mmHg/mL
_R = MMHG / _ML  # mmHg s/mL

_KORAKIANITIS = "T. Korakianitis, Y. Shi, J. Biomech. 39, 1964 (2006), doi:10.1016/j.jbiomech.2005.06.016"

HUMAN = Heart(
    name="human_heart",
    reference=f"Chambers, timings, areas of the valves and venous resistance: {_KORAKIANITIS}. "
    "Our choice: lengths and rates of the valves.",
    heart=Pace(rate=1.0),
    left_ventricle=Chamber(2.5 * _E, 0.1 * _E, 5.0 * _ML, 1.0 * MMHG, begin=0.0, rise=0.3, fall=0.15),
    left_atrium=Chamber(0.25 * _E, 0.15 * _E, 4.0 * _ML, 1.0 * MMHG, begin=0.92, rise=0.045, fall=0.045),
    # areas of the orifice flow Q = C sqrt(ΔP), C = 400 and 350 mL/s/sqrt(mmHg): A = C sqrt(ρ/2)
    mitral_valve=Valve(A=7.98e-4, l=0.02, R=0.0, K_open=0.3, K_close=0.3, regurgitation=0.0),
    aortic_valve=Valve(A=6.98e-4, l=0.02, R=0.0, K_open=0.12, K_close=0.12, regurgitation=0.0),
    venous=Filling(R=0.006 * _R),
    P_venous=8.0 * MMHG,
    P_aorta=80.0 * MMHG,
)

HUMAN_BODY = Body(
    name="human_body",
    reference=f"Compliance: systemic and pulmonary veins together, {_KORAKIANITIS}. Our choice: volumes.",
    body=Reservoir(C=41.0 * _ML / MMHG, V_unstressed=2500.0 * _ML, P_start=8.0 * MMHG),
)

SPECIES = {"human": (HUMAN, HUMAN_BODY)}
