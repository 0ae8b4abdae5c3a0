"""Several recordings of one subject as one record: common unknowns, and unknowns of each recording.

    |z|² + Σ (x_i/s_i)²,    z = (z_1(x_c, x_1), …, z_n(x_c, x_n)),

with the whitened residual z_i of each recording, the common unknowns x_c (walls, geometry, sensors, effects) and the
unknowns x_i that vary. Each recording has its own period, drive and noise. The Jacobian has a block of rows for each
recording; a block is 0 in the columns of the unknowns of other recordings. An unknown of one recording has the name of
that in its name: "CA.E of B". Code that reads a joint fit as one of the network reads the first recording: the unknowns
of the others move variables "CA.E of B", which no network has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property, partial
from typing import Any, Self

import numpy as np

from solver.errors import InputError
from solver.network.description import Network

from ...records.alignment.beats import Beats
from ..extended_network import allowed
from ..fit import Array, Fit, Member, begun, taken_over
from ..forward import Forward, Single
from ..gauss_newton import Point, Search, Trial, continued, promised, search
from ..hypothesis import PlacedEffect
from ..jackknife import Rest
from ..model_discrepancy import Beside, settled
from ..models.bench import Bench
from ..models.network import NetworkProblem
from ..runs import Runs
from ..source_maps.source_map import found_beside
from ..unknown import OUTLIER, Unknown
from ..unknown_text import named, parse_unknown


@dataclass(frozen=True)
class Several(Forward):
    """Problems of recordings of one subject, compared with one network; all of networks, or all of one site.

    labels : of the recordings. varies : patterns of parameter names, as "*.outlet.R2", that each recording has of its
    own. beats : of each recording, the fitted and the held-out ones.
    """

    parts: tuple[Single, ...]
    labels: tuple[str, ...]
    varies: tuple[str, ...] = ()
    beats: tuple[tuple[Beats, Beats], ...] = ()

    # --- common unknowns and those of one recording ------------------------------------------------------------------

    @property
    def first(self) -> Single:
        return self.parts[0]

    @property
    def network(self) -> Network:  # type: ignore[override]
        return self.first.network

    @property
    def site(self) -> str | None:  # type: ignore[override]
        return self.first.site

    @property
    def signals(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(
            f"{name} of {label}" for part, label in zip(self.parts, self.labels, strict=True) for name in part.signals
        )

    @property
    def accuracy(self) -> float:  # type: ignore[override]
        return self.first.accuracy

    @property
    def dof_of_noise(self) -> float:
        return sum(part.dof_of_noise for part in self.parts)

    @property
    def deviations(self) -> tuple[Unknown, ...]:
        return self.first.deviations

    def individual(self) -> Self:
        return replace(self, parts=tuple(part.individual() for part in self.parts))

    @cached_property
    def added(self) -> tuple[Unknown, ...]:
        """Parameters that vary but are no unknown of a single recording, as a venous pressure; one unknown per key.

        Raises InputError if a pattern of ``varies`` matches no parameter.
        """
        numbers = self.first.part(self.network).parameters()
        known = [(u, set(u.variables)) for u in self.first.hypothesis(())]
        found: dict[str, list[str]] = {}
        for pattern in self.varies:
            there = [n for n in numbers if fnmatchcase(n, pattern)]
            there = [n for n in there if self.site is None or ".outlet." not in n]
            mine = [variables for u, variables in known if named(u, pattern)]
            if not (there or mine):
                raise InputError(
                    f"--varies {pattern}: it names no number of {self.network.name} that could vary; write it as "
                    f'"*.E", "*.outlet.R2" or "{self.network.segments[0].name}.E".'
                )
            for name in (n for n in there if not any(n in variables for variables in mine)):
                where, _, key = name.partition(".")
                found.setdefault(key, []).append(where)
        names = [f"{'+'.join(dict.fromkeys(where))}.{key}" for key, where in found.items()]
        # bounded, because R2 and P_venous are aliases
        return tuple(parse_unknown(name, self.network).within(OUTLIER) for name in names)

    def hypothesis(self, terms: Sequence[PlacedEffect]) -> tuple[Unknown, ...]:
        mine = [u for t in terms for u in t.unknowns]
        present = {v for t in terms if t.rewires for u in t.unknowns for v in u.variables}
        animal = [u for u in self.first.hypothesis(terms) if u not in mine]
        found = list[Unknown]()
        for u in (*animal, *(a for a in self.added if not set(a.variables) & present)):
            found += [self._of(u, i) for i in range(len(self.parts))] if self.differs(u) else [u]
        return (*found, *mine)

    def differs(self, unknown: Unknown) -> bool:
        """True if each recording has its own value of an unknown of a single recording."""
        return unknown in self.added or any(named(unknown, pattern) for pattern in self.varies)

    def _of(self, unknown: Unknown, i: int) -> Unknown:
        """The unknown of recording i. Only that of the first recording moves a variable of the network."""
        label = f" of {self.labels[i]}"
        moves = unknown.moves if i == 0 else tuple((f"{variable}{label}", step) for variable, step in unknown.moves)
        return replace(unknown, name=f"{unknown.name}{label}", moves=moves)

    def _whose(self, unknown: Unknown) -> int | None:
        """The index of the recording that owns an unknown; None if it is common."""
        mine = [i for i, label in enumerate(self.labels) if unknown.name.endswith(f" of {label}")]
        return max(mine, key=lambda i: len(self.labels[i]), default=None)

    def own(self, unknowns: Sequence[Unknown], i: int) -> tuple[tuple[Unknown, ...], Array]:
        """The unknowns of recording i under their names in that recording, and their indices among all unknowns."""
        whose = [self._whose(u) for u in unknowns]
        which = [j for j, w in enumerate(whose) if w in (None, i)]
        label, found = f" of {self.labels[i]}", list[Unknown]()
        for j in which:
            u = unknowns[j]
            if whose[j] is not None:
                moves = tuple((variable.removesuffix(label), step) for variable, step in u.moves)
                u = replace(u, name=u.name.removesuffix(label), moves=moves)
            found.append(u)
        return tuple(found), np.array(which, int)

    def of(self, fit: Fit, i: int) -> Fit:
        """The joint fit as a fit to recording i: its unknowns, its rows of z and J."""
        unknowns, which = self.own(fit.unknowns, i)
        rows, (order, signal) = self.rows[i], self.parts[i].entries
        return replace(fit, unknowns=unknowns, x=fit.x[which], z=fit.z[rows], J=fit.J[rows][:, which],
                       order=order, signal=signal, log_volume=0.0,
                       derived_at=fit.x[which] if fit.derived else None)  # fmt: skip

    @cached_property
    def rows(self) -> list[slice]:
        """The rows of z of each recording."""
        ends = np.cumsum([0, *(len(part.entries[0]) for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    @property
    def entries(self) -> tuple[Array, Array]:
        ends = np.cumsum([0, *(len(part.signals) for part in self.parts)])
        order, signal = zip(*(part.entries for part in self.parts), strict=True)
        return np.concatenate(order), np.concatenate([s + end for s, end in zip(signal, ends[:-1], strict=True)])

    # --- the search ---------------------------------------------------------------------------------------------------

    def points(self, trials: Sequence[Trial], runs: Runs) -> list[Point | None]:
        """The residuals of all recordings at every trial, concatenated, and their derivatives."""
        runs.check()
        owns = [[self._trial(t, i) for t in trials] for i in range(len(self.parts))]
        found = [part.points(mine, runs) for part, mine in zip(self.parts, owns, strict=True)]
        return [self._joined(t, each) for t, *each in zip(trials, *found, strict=True)]

    def member(self, member: Member, i: int) -> Member:
        """A point of a hypothesis as one of recording i."""
        unknowns, which = self.own(member.unknowns, i)
        return Member(member.terms, unknowns, member.x[which])

    def _trial(self, trial: Trial, i: int) -> Trial:
        which = self.own(trial.member.unknowns, i)[1]
        by = np.flatnonzero(np.isin(which, trial.by))
        memory = None if trial.before is None else trial.before.memory  # None also of a point known beforehand
        return Trial(self.member(trial.member, i), by, None if memory is None else memory[i], trial.step[which])

    def _joined(self, trial: Trial, found: Sequence[Point | None]) -> Point | None:
        known = [point for point in found if point is not None]
        if len(known) < len(found):
            return None
        J = self._jacobian(trial.member.unknowns, trial.by, known)
        return Point(np.concatenate([p.z for p in known]), J, sum(p.log_volume for p in known), tuple(known))

    def _jacobian(self, unknowns: Sequence[Unknown], by: Array, own: Sequence[Point | Fit]) -> Array:
        """(n, q) derivatives by the unknowns ``by`` : (q,), 0 for recordings that do not have the unknown."""
        J = np.zeros((sum(len(each.z) for each in own), len(by)))
        for i, (rows, each) in enumerate(zip(self.rows, own, strict=True)):
            J[rows, np.isin(by, self.own(unknowns, i)[1])] = each.J
        return J

    def searched_from(
        self, members: Sequence[Member], runs: Runs, known: Mapping[str, Array] | None = None, cost: float = np.inf
    ) -> list[Fit | None]:
        """Fit hypotheses from given starting points. known : whitened derivatives (n,) by unknown, which save the first
        simulations. cost : of a hypothesis, as in :meth:`refit`."""
        rules = self.rules if cost < np.inf else replace(self.rules, hopeless=np.inf)
        searches = [Search(m, rules, known=known if rules.fresh else None) for m in members]
        return self._ended(searches, runs, cost)

    def _ended(self, searches: Sequence[Search], runs: Runs, known: float = np.inf) -> list[Fit | None]:
        search(partial(self.points, runs=runs), searches, known)
        found = [None if s.failed or s.here is None else s.fit(*self.entries) for s in searches]
        each = range(len(self.parts))
        return [f if f and all(allowed(self.network, self.of(f, i)) for i in each) else None for f in found]

    def nearest(self, choices: Sequence[Sequence[Member]], runs: Runs, start: Fit | None = None) -> list[Member]:
        """Of each choice the point of lowest cost, or of lowest predicted cost after ``start``'s unknowns adapt."""
        members = [m for some in choices if len(some) > 1 for m in some]
        points = self.points([Trial(m, np.arange(0), None, 0.0 * m.x) for m in members], runs) if members else []
        # a point whose simulation breaks down costs ∞
        costs = iter([np.inf if p is None else promised(p.z, start) + p.log_volume for p in points])
        each = [[next(costs) for _ in some] if len(some) > 1 else [0.0] for some in choices]
        return [some[int(np.argmin(mine))] for some, mine in zip(choices, each, strict=True)]

    def begin(self, terms: tuple[PlacedEffect, ...], start: Fit | None = None) -> list[Member]:
        """Starting points for a hypothesis: another fit, with its new terms at each of their starts."""
        unknowns = self.hypothesis(terms)
        known = set() if start is None else {u.name for u in start.unknowns}
        members = [taken_over(terms, unknowns, start)]
        for term in terms:
            if term.starts and not {u.name for u in term.unknowns} <= known:
                members = [trial for m in members for trial in begun(m, term)]
        return members

    def refit(self, hypotheses: Sequence[tuple[PlacedEffect, ...]], start: Fit | None = None, runs: Runs | None = None,
              columns: Mapping[str, Array] | None = None, known: float = np.inf) -> list[Fit | None]:  # fmt: skip
        runs = runs or Runs()
        members = self.nearest([self.begin(t, start) for t in hypotheses], runs, start)
        own = derivatives(start, hypotheses, columns) if start and columns else None
        return self.searched_from(members, runs, own, known)

    def refine(self, fits: Sequence[Fit], runs: Runs | None = None) -> list[Fit | None]:
        rules = replace(self.fine, hopeless=np.inf)
        # without Broyden's updates a point has a memory, which a fit has not
        each = [continued(f, rules) if rules.fresh else Search(f.member, rules) for f in fits]
        return self._ended(each, runs or Runs())

    def relaxed(self, fits: Sequence[Fit], runs: Runs | None = None, rough: bool = False) -> list[Fit | None]:
        return self.refine(fits, runs)

    # --- weights ------------------------------------------------------------------------------------------------------

    def sharpened(self, fit: Fit, runs: Runs | None = None) -> Self:
        parts = tuple(part.sharpened(self.of(fit, i), runs) for i, part in enumerate(self.parts))
        return self if all(a is b for a, b in zip(parts, self.parts, strict=True)) else replace(self, parts=parts)

    def restated(self, fits: Sequence[Fit], before: Several) -> list[Fit]:
        each = [part.restated([self.of(f, i) for f in fits], before.parts[i]) for i, part in enumerate(self.parts)]
        found = []
        for fit, *own in zip(fits, *each, strict=True):
            J = self._jacobian(fit.unknowns, np.arange(len(fit.x)), own)
            z = np.concatenate([f.z for f in own])
            at = fit.derived_at if all(f.derived for f in own) else None
            found.append(replace(fit, z=z, J=J, log_volume=sum(f.log_volume for f in own), derived_at=at))
        return found

    def columns(self, at: Fit, terms: Sequence[PlacedEffect], runs: Runs | None = None) -> dict[str, Array]:
        found = [part.columns(self.of(at, i), terms, runs) for i, part in enumerate(self.parts)]
        return {n: np.concatenate([own[n] for own in found]) for n in found[0] if all(n in own for own in found)}

    def rewhitened(self, columns: Mapping[str, Array], before: Several) -> dict[str, Array]:
        found = [
            part.rewhitened({n: column[self.rows[i]] for n, column in columns.items()}, before.parts[i])
            for i, part in enumerate(self.parts)
        ]
        return {n: np.concatenate([own[n] for own in found]) for n in columns}

    def left_of_pulsation(self, fit: Fit) -> float:
        """RMS over all channels of their residuals, each over the RMS of its pulsation, in networks."""
        pairs = zip(self.parts, self.rows, strict=True)
        each = [part.left_of_pulsation(fit.z[rows]) for part, rows in pairs if isinstance(part, NetworkProblem)]
        return float(np.sqrt(np.mean(np.concatenate(each) ** 2)))

    def beside(self, fit: Fit) -> Beside | None:
        """The fit with model discrepancy, estimated for each recording separately; None if no recording has any."""
        each = [_beside(part, self.of(fit, i)) for i, part in enumerate(self.parts)]
        found = [b for b in each if b is not None]
        if not found:
            return None
        errors: Any = tuple(None if b is None else b.errors for b in each)
        wide = self.widened(errors)
        whole = wide.restated([fit], self)[0]
        if self.site is None:
            whole = replace(whole, log_volume=sum(b.fit.log_volume for b in found))
        places = tuple({p.key: p for b in found for p in b.places}.values())
        return Beside(settled(whole), errors, sum(b.cost for b in found), places)

    def widened(self, errors: Any) -> Self:
        pairs = zip(self.parts, errors, strict=True)
        return replace(self, parts=tuple(part if e is None else part.widened(e) for part, e in pairs))

    def refined(self, fit: Fit, term: PlacedEffect) -> PlacedEffect | None:
        return self.first.refined(self.of(fit, 0), term)

    def held_out(self, beats: Beats, fitted: Beats) -> Several:
        """The problem on the held-out beats of every recording; the arguments are those of the first."""
        kept = tuple(part.held_out(last, first) for part, (first, last) in zip(self.parts, self.beats, strict=True))
        return replace(self, parts=kept)

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        own = [[self.member(f.member, i) for f in fits] for i in range(len(self.parts))]
        found = [
            part.predict([replace(f, unknowns=m.unknowns, x=m.x) for f, m in zip(fits, mine, strict=True)])
            for part, mine in zip(self.parts, own, strict=True)
        ]
        return [(sum(chi2 for chi2, _ in each), sum(n for _, n in each)) for each in zip(*found, strict=True)]

    def without_each(self, fit: Fit) -> list[Rest]:
        found = list[Rest]()
        for i, part in enumerate(self.parts):
            others = np.delete(np.arange(len(fit.z)), self.rows[i])
            for J, z in part.without_each(self.of(fit, i)):
                mine = np.zeros((len(z), len(fit.x)))
                mine[:, self.own(fit.unknowns, i)[1]] = J
                found.append((np.concatenate([fit.J[others], mine]), np.concatenate([fit.z[others], z])))
        return found

    def shows(self, fit: Fit) -> bool:
        return all(part.shows(self.of(fit, i)) for i, part in enumerate(self.parts))


def derivatives(
    start: Fit, hypotheses: Sequence[tuple[PlacedEffect, ...]], columns: Mapping[str, Array]
) -> dict[str, Array]:
    """The whitened derivatives (n,) of a fit by its unknowns and by those of the terms that ``columns`` has."""
    terms = [t for terms in hypotheses for t in terms if t.label in columns]
    new = [t for t in terms if columns[t.label].shape[1] == len(t.unknowns)]
    return start.columns | {u.name: columns[t.label][:, i] for t in new for i, u in enumerate(t.unknowns)}


def _beside(part: Single, fit: Fit) -> Beside | None:
    """The discrepancy model of a fit to one recording."""
    if isinstance(part, Bench):
        return part.beside(fit)
    assert isinstance(part, NetworkProblem)
    return found_beside(part, fit)
