"""The paper's scheme: finite volumes with limited linear reconstruction (MUSCL), beside the default in `solver.scheme`.

    ∂A/∂t + ∂Q/∂x = 0                                                          (`massConserv_AQ`)
    ∂Q/∂t + ∂/∂x (α Q²/A + Π) - ∂Π/∂x|_P + C_f Q/A = A/ρ ∂/∂x (ν_s ∂Q/∂x)      (`momentumConserv_AQ`)

with Π = ∫ A/ρ dP_el at fixed x, and the wall of `sheep_constitutive`, whose viscous part is ν_s ∂A/∂t = -ν_s ∂Q/∂x.

Space: cells; elastic pressure and flow are reconstructed with (limited) slopes, fluxes are Rusanov's. A wall that
changes along the segment enters by ∂Π/∂x at fixed pressure, so that a fluid at rest stays at rest. Viscous pressure: by
central differences. Time: two steps, the hyperbolic part extrapolated, the viscous one implicit and L-stable (SBDF2:
U. M. Ascher, S. J. Ruuth, B. T. R. Wetton, SIAM J. Numer. Anal. 32 (1995) 797); each step of the output is cut into as
many as the CFL number asks for. Where segments end the elastic pressure follows from the outgoing characteristic, and
one linear system for all nodes says ΣQ = 0, what drives the inlet, and the loads of the outlets.

ends : "coupled", the viscous pressure takes part in all this, or "neumann", as published: ∂Q/∂x = 0 there.

MUSCL: B. van Leer, J. Comput. Phys. 32 (1979) 101; for arteries: X. Wang, J.-M. Fullana, P.-Y. Lagrée, Comput. Methods
Biomech. Biomed. Engng 18 (2015) 1704; rest on tapered walls: O. Delestre, P.-Y. Lagrée, Int. J. Numer. Meth. Fluids 72
(2013) 177, here by pressure.
"""

from .model import Model, build
from .sampling import reporter
from .settings import MusclSettings
from .start import periodic_state
from .step import State, adopt, initial_state, step

__all__ = ["Model", "MusclSettings", "State", "adopt", "build", "initial_state", "periodic_state", "reporter", "step"]
