"""A hypothesis strategy for random networks: any tree, any outlets, every quantity anywhere in its allowed range."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from solver.laws.outlets import OUTLETS
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.network.description import Fluid, Inlet, Junction, Network, Segment, Site
from solver.quantities.quantity import quantities


def numbers(kind: type) -> st.SearchStrategy[dict[str, float]]:
    """Values of all quantities of a dataclass."""
    return st.fixed_dictionaries(
        {key: st.floats(q.low, q.high, exclude_min=q.open_low) for key, q in quantities(kind).items()}
    )


def segments(name: str) -> st.SearchStrategy[Segment]:
    def allowed(values: dict[str, float]) -> dict[str, float]:
        largest = 100.0 * values["phi0"]
        return {**values, "phiNL": min(max(values["phiNL"], -largest), largest)}

    return numbers(Segment).map(lambda values: Segment(name, **allowed(values)))


@st.composite
def networks(draw: Any) -> Network:
    """A tree of up to six segments; S0 is the root, and every segment without children ends in an outlet."""
    count = draw(st.integers(1, 6))
    parents = [draw(st.integers(0, i - 1)) for i in range(1, count)]
    children = {i: tuple(f"S{j}" for j, p in enumerate(parents, 1) if p == i) for i in range(count)}
    leaves = [i for i in children if not children[i]]
    kinds = {i: draw(st.sampled_from(OUTLETS)) for i in leaves}
    return Network(
        name="random",
        reference=draw(st.text(st.characters(exclude_categories=["Cs"]))),
        segments=tuple(draw(segments(f"S{i}")) for i in range(count)),
        inlet=Inlet("S0", **draw(numbers(Inlet))),
        junctions=tuple(Junction((f"S{i}",), children[i], **draw(numbers(Junction))) for i in children if children[i]),
        outlets=tuple(kinds[i](f"S{i}", **draw(numbers(kinds[i]))) for i in leaves),
        sites=tuple(
            Site(f"place_{i}", f"S{draw(st.integers(0, count - 1))}", **draw(numbers(Site)))
            for i in range(draw(st.integers(0, 3)))
        ),
        fluid=Fluid(**draw(numbers(Fluid))),
        elastic_law=draw(st.sampled_from(sorted(ELASTIC_LAWS))),
        viscous_law=draw(st.sampled_from(sorted(VISCOUS_LAWS))),
        **draw(numbers(Network)),
    )
