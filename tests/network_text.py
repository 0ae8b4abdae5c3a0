"""A network file as text."""

from __future__ import annotations

FORK = """
name = "fork"

[fluid]
rho = "1.06 g/cm^3"

[inlet]
segment = "AA"
Q_max = "55 cm^3/s"

[segments.AA]
L = "4 cm"
R0 = "0.948 cm"
h = "0.38 mm"
E = "1.539 MPa"
phi0 = "25.451 kPa*s"

[segments.BT]
L = 0.04
R0 = 9e-3
h = "1.06 mm"
E = "683 kPa"

[segments.PD]
L = "10 cm"
R0 = "8.8 mm"
h = "0.91 mm"
E = "8.42e6 dyn/cm^2"

[[junctions]]
in = ["AA"]
out = ["BT", "PD"]

[outlets.BT]
R1 = "1 mmHg*s/mL"
C = "0.1 mL/mmHg"
R2 = "10 mmHg.s/mL"

[outlets.PD]
R_t = 0.3
"""
