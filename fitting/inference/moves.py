"""Moves of a search for places: one more, one less, another in its stead, as the evidence of the linear problem has
them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from .hierarchy import APART, beforehand
from .place_model import SETTLED, Active, PlaceModel, Point
from .source_evidence import FIRST_LOOK, PRICE, Normal, marginal

MOST = 3  # places at once
CLOSELY = 14  # places that are looked at closely, of all

Move = tuple[float, tuple[Active, ...]]  # -2 ln evidence, and the places that act


class Moves:
    """The moves about a point of a model."""

    def __init__(self, model: PlaceModel) -> None:
        self.model = model

    def best(self, normal: Normal, point: Point) -> Move | None:
        """The move that the evidence gains most by; None where none is worth it."""
        found = min(self.all(normal, point), key=lambda move: move[0], default=(math.inf, point.active))
        return found if found[0] <= point.score - SETTLED else None

    def all(self, normal: Normal, point: Point) -> Iterator[Move]:
        """Places added; where that gains nothing, dropped and swapped."""
        adds = self.looked(normal, point.active, point, CLOSELY) if len(point.active) < MOST else []
        yield from adds
        if min((score for score, _ in adds), default=math.inf) > point.score - SETTLED:
            yield from self.without_each(normal, point, CLOSELY // 2)

    def without_each(self, normal: Normal, point: Point, closely: int) -> Iterator[Move]:
        """Places dropped and swapped."""
        same = {a.place.key for a in point.active}
        for i in range(len(point.active)):
            rest = (*point.active[:i], *point.active[i + 1 :])
            score, rest, _ = self.model.inferred(normal, rest, point.widths, point.x)
            yield score, rest
            for other in self.looked(normal, rest, point, closely):
                if {a.place.key for a in other[1]} != same:
                    yield other

    def looked(self, normal: Normal, active: tuple[Active, ...], point: Point, closely: int) -> list[Move]:
        """-2 ln evidence with one place more: of all places at a few sizes, then of the best with all inferred."""
        sd = self.model.sd(active, point.widths)
        reduced = normal.without(self.model.columns_of(active), self.model.variance(active))
        there, quick = {a.place.key for a in active}, list[tuple[float, Active]]()
        for place in (p for p in self.model.places if p.key not in there):
            if place.unknown is not None:
                i = self.model.unknowns.index(place.unknown)
                wider = np.tile(sd, (len(APART), 1))
                wider[:, i] = APART
                score = float(marginal(reduced.of_unknowns, wider).min()) + reduced.log_volume
                quick.append((score + beforehand(APART[0], True), Active(place)))
            else:
                score, law = reduced.best_law(self.model.columns[place.key], place.relative, sd, *FIRST_LOOK)
                quick.append((score + PRICE, Active(place, law)))
        quick.sort(key=lambda each: each[0])
        found = []
        for _, added in quick[:closely]:
            score, both, _ = self.model.inferred(normal, (*active, added), point.widths, point.x, 1)
            found.append((score, both))
        return sorted(found, key=lambda each: each[0])
