"""The paper's scheme: finite volumes with limited linear reconstruction (MUSCL); the default is in `solver.scheme`.

    ∂A/∂t + ∂Q/∂x = 0                                                          (`massConserv_AQ`)
    ∂Q/∂t + ∂/∂x (α Q²/A + Π) - ∂Π/∂x|_P + C_f Q/A = A/ρ ∂/∂x (ν_s ∂Q/∂x)      (`momentumConserv_AQ`)

with Π = ∫ A/ρ dP_el at fixed x, and the wall of `sheep_constitutive`, whose viscous part is ν_s ∂A/∂t = -ν_s ∂Q/∂x.

Space: elastic pressure and flow are reconstructed in the cells with (limited) slopes; fluxes are Rusanov's. The term
∂Π/∂x at fixed pressure accounts for a wall that changes along the segment, so that a fluid at rest stays at rest. The
viscous pressure uses central differences. Time: a two-step method, with the hyperbolic part extrapolated, the viscous
part implicit and L-stable (SBDF2: U. M. Ascher, S. J. Ruuth, B. T. R. Wetton, SIAM J. Numer. Anal. 32 (1995) 797); the
CFL number divides each output step into sub-steps. At the ends of segments the elastic pressure follows from the
outgoing characteristic, and one linear system for all nodes contains ΣQ = 0, the drive of the inlet and the loads of
the outlets.

ends : "coupled", which includes the viscous pressure there, or "neumann", as published: ∂Q/∂x = 0.

MUSCL: B. van Leer, J. Comput. Phys. 32 (1979) 101; for arteries: X. Wang, J.-M. Fullana, P.-Y. Lagrée, Comput. Methods
Biomech. Biomed. Engng 18 (2015) 1704; rest on tapered walls: O. Delestre, P.-Y. Lagrée, Int. J. Numer. Meth. Fluids 72
(2013) 177, here by pressure.
"""
