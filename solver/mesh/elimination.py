"""The system of the nodal pressures, solved at a cost proportional to the number of nodes.

Nodes i and j are coupled if an element joins them. Arteries branch, so most nodes have one or two neighbours. These are
eliminated in rounds of nodes that are not neighbours of each other; each elimination couples the neighbours of the
node. A round removes leaves and every second node of a chain, so that a tree of n nodes takes O(log n) rounds, and a
network with loops is reduced to these. The remaining core is inverted as a whole. The order is computed once per mesh.

Elimination by rounds: G. L. Miller, J. H. Reif, Parallel tree contraction, Proc. 26th FOCS (1985) 478.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

Array = np.ndarray
Index = Array | slice

CORE = 96  # nodes that are inverted as a whole: below, a product with the inverse costs less than a round
_WHOLE = 160_000  # numbers, 1.3 MB: for inverses up to this size, a product costs less than the rounds
_WORTH = 0.1  # least fraction of the nodes that a round must remove: where many loops meet, few can be


class Sums(NamedTuple):
    """Sums of terms by target. order : the terms by target; first : (n,) the first term of each target; targets :
    (n,)."""

    order: Array
    first: Array
    targets: Array

    @staticmethod
    def of(targets: Array) -> Sums:
        """For terms with targets : (n_terms,)."""
        order = np.argsort(targets, kind="stable")
        each, first = np.unique(targets[order], return_index=True)
        return Sums(order, first, each)


class Round(NamedTuple):
    """Nodes v that are eliminated together; each has a near and a far neighbour, or a near one that counts as both.

    nodes : (m,) v. near, far : (m,). row, column : entries (2, m) G_v,near and G_v,far, G_near,v and G_far,v.
    gives : sums of the changes of G of the neighbours, (2, 2, m) terms. passes : sums of the changes of their right
    sides, (2, m) terms; source : the nodes v of these.
    """

    nodes: Array
    near: Array
    far: Array
    row: Array
    column: Array
    gives: Sums
    passes: Sums
    source: Array


@dataclass(frozen=True)
class Elimination:
    """The elimination order of a system of n nodes coupled by elements.

    Entries of G are numbered: the diagonal first, then those of element ends, then the fill-in. The last one is 0. n,
    n_entries : numbers of nodes and entries. elements : sums of the (4 n_e) products of element ends (left with left
    and right, right with left and right) to entries. rows : the equation's node of every entry. core : remaining nodes;
    inner : their entries (n_core, n_core).
    """

    n: int
    n_entries: int
    elements: Sums
    rows: Array
    rounds: tuple[Round, ...]
    core: Index
    inner: Array

    def factor(self, products: Array, scale: Array, less: Array) -> Factor:
        """-G⁻¹ of G = scale · Σ products - diag(less). products : (B, 4 n_e) flow into the node of each element end by
        the pressure at each end. scale, less : (B, n) of each node's equation.

        Raises LinAlgError if G is singular.
        """
        G = np.zeros_like(products, shape=(len(products), self.n_entries))
        G[:, self.elements.targets] = np.add.reduceat(products.take(self.elements.order, 1), self.elements.first, 1)
        G[:, :-1] *= scale.take(self.rows, 1)
        G[:, : less.shape[1]] -= less
        passed, taken, own = list[Array](), list[Array](), list[Array]()
        for r in self.rounds:
            pivot = G[:, r.nodes]
            if not pivot.all():
                raise np.linalg.LinAlgError("Singular matrix")
            column, row = G[:, r.column] / pivot[:, None], G[:, r.row]
            change = (column[:, :, None] * row[:, None]).reshape(len(G), -1)
            G[:, r.gives.targets] -= np.add.reduceat(change.take(r.gives.order, 1), r.gives.first, 1)
            passed.append(column.reshape(len(G), -1).take(r.passes.order, 1))
            taken.append(-row / pivot[:, None])
            own.append(-1.0 / pivot)
        return Factor(self, tuple(passed), tuple(taken), tuple(own), -np.linalg.inv(G[:, self.inner]))


@dataclass(frozen=True)
class Factor:
    """-G⁻¹: for every round the factors passed to neighbours, (B, 2 m), those of back substitution, (B, 2, m), and the
    inverse pivots, (B, m); inverse : of the core."""

    plan: Elimination
    passed: tuple[Array, ...]
    taken: tuple[Array, ...]
    own: tuple[Array, ...]
    inverse: Array

    @staticmethod
    def joined(factors: Sequence[Factor]) -> Factor:
        """The factors of several systems as one batch."""
        passed, taken, own = (
            tuple(map(np.concatenate, zip(*(getattr(f, part) for f in factors), strict=True)))
            for part in ("passed", "taken", "own")
        )
        return Factor(factors[0].plan, passed, taken, own, np.concatenate([f.inverse for f in factors]))

    def whole(self) -> Factor:
        """The same as an inverse of the whole system, if that is small: for a factor that is used often."""
        if not self.plan.rounds or len(self.inverse) * self.plan.n**2 > _WHOLE:
            return self
        unit = np.eye(self.plan.n, dtype=self.inverse.dtype)
        columns = [self.member(b).solve(unit) for b in range(len(self.inverse))]
        inverse = np.ascontiguousarray(np.swapaxes(columns, 1, 2))
        return Factor(replace(self.plan, rounds=(), core=slice(None)), (), (), (), inverse)

    def member(self, b: int) -> Factor:
        """The factor of one system of a batch."""
        own_b = slice(b, b + 1)
        passed, taken, own = (tuple(x[own_b] for x in rounds) for rounds in (self.passed, self.taken, self.own))
        return replace(self, passed=passed, taken=taken, own=own, inverse=self.inverse[own_b])

    def solve(self, net: Array) -> Array:
        """-G⁻¹ net : (B, n)."""
        if not self.plan.rounds:
            return np.matmul(self.inverse, net[..., None])[..., 0]
        remaining = net.copy()
        for r, passed in zip(self.plan.rounds, self.passed, strict=True):
            going = passed * remaining.take(r.source, 1)
            remaining[:, r.passes.targets] -= np.add.reduceat(going, r.passes.first, 1)
        found = np.empty_like(remaining)
        found[:, self.plan.core] = np.matmul(self.inverse, remaining[:, self.plan.core, None])[..., 0]
        for r, taken, own in zip(reversed(self.plan.rounds), reversed(self.taken), reversed(self.own), strict=True):
            x = own * remaining.take(r.nodes, 1)
            x += taken[:, 0] * found.take(r.near, 1)
            x += taken[:, 1] * found.take(r.far, 1)
            found[:, r.nodes] = x
        return found


# --- which node goes when -----------------------------------------------------------------------------------------


@lru_cache(maxsize=32)
def eliminated(ends: bytes, n: int, core: int = CORE) -> Elimination:
    """As :func:`eliminate`, from the bytes of the ends: meshes with the same connections share it."""
    return eliminate(np.frombuffer(ends, int).reshape(-1, 2), n, core)


def eliminate(ends: Array, n: int, core: int = CORE) -> Elimination:
    """The elimination of n nodes coupled by elements with ends : (n_e, 2), until about ``core`` of them remain."""
    entries = {(i, i): i for i in range(n)}

    def entry(i: int, j: int) -> int:
        return entries.setdefault((i, j), len(entries))

    pairs = [(i, j) for a, b in ends.tolist() for i in (a, b) for j in (a, b)]
    elements = Sums.of(np.array([entry(i, j) for i, j in pairs]))
    beside: dict[int, set[int]] = {i: set() for i in range(n)}
    for i, j in entries:
        beside[i] |= {j} - {i}
    rounds = list[Round]()
    while len(beside) > core:
        going = _apart(beside)
        if len(going) < _WORTH * len(beside):
            break
        rounds.append(_round(going, [sorted(beside[v]) for v in going], entry))
        for v in going:
            others = beside.pop(v)
            for i in others:
                beside[i] = (beside[i] | others) - {i, v}
    stay = np.array(sorted(beside))
    key = np.array(list(entries))
    inner = np.full((n, n) if not rounds else (len(stay), len(stay)), -1)
    place = np.full(n, -1)
    place[stay] = np.arange(len(stay))
    row, column = place[key].T
    both = (row >= 0) & (column >= 0)
    inner[row[both], column[both]] = np.flatnonzero(both)
    return Elimination(n, len(key) + 1, elements, key[:, 0], tuple(rounds), stay if rounds else slice(None), inner)


def _apart(beside: dict[int, set[int]]) -> list[int]:
    """Nodes with at most two neighbours, no two of them neighbours; those with one first."""
    found, taken = list[int](), set[int]()
    for v in sorted((v for v, others in beside.items() if len(others) <= 2), key=lambda v: len(beside[v])):
        if v not in taken:
            found.append(v)
            taken |= beside[v]
    return found


def _round(nodes: list[int], beside: Iterable[list[int]], entry: Callable[[int, int], int]) -> Round:
    """The round that eliminates nodes with these one or two neighbours."""
    near, far = np.array([(others[0], others[-1]) for others in beside]).T
    two = near != far
    pairs = ((near, near), (near, far), (far, near), (far, far))

    def entries(i: Array, j: Array) -> Array:
        return np.array(list(map(entry, i.tolist(), j.tolist())))

    v = np.array(nodes)
    passes = Sums.of(np.concatenate([near, far]))
    return Round(
        nodes=v,
        near=near,
        far=far,
        row=np.stack([entries(v, near), np.where(two, entries(v, far), -1)]),
        column=np.stack([entries(near, v), np.where(two, entries(far, v), -1)]),
        gives=Sums.of(np.concatenate([entries(i, j) for i, j in pairs])),
        passes=passes,
        source=np.tile(v, 2)[passes.order],
    )
