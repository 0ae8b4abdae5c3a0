"""Prediction of held-out recordings by a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver import Settings
from solver.network.description import Network

from ..inference.unknown import Unknown
from ..parallel.threads import single_threaded
from ..records.alignment.beats import Beats
from .calibrated import Calibration
from .network_calibration import calibrate


@dataclass(frozen=True)
class HeldOut:
    """A held-out recording. rms : over the beat [SI] by channel, with the common values and, for varying unknowns, the
    mean of the recordings. refitted : the same with the varying unknowns fitted to this recording, and their ``values``
    [SI]; empty if all unknowns are common."""

    source: str
    rms: Mapping[str, float]
    refitted: Mapping[str, float]
    values: Mapping[str, float]

    def plain(self) -> dict[str, Any]:
        """For the provenance of a parameter set; SI."""
        return {"record": self.source, **{key: dict(getattr(self, key)) for key in ("rms", "refitted", "values")}}


@single_threaded
def judge(
    found: Calibration,
    beats: Beats,
    network: Network,
    settings: Settings | None = None,
) -> HeldOut:
    """The residual of a calibration in another recording of the same subject.

    network, settings : those of the calibration. Raises ValueError as
    :func:`fitting.calibrate.network_calibration.calibrate`.
    """
    single, x = found.of(0), np.mean([found.x[list(each.which)] for each in found.recordings], axis=0)
    varies = [any(each.which[j] != found.recordings[0].which[j] for each in found.recordings) for j in range(len(x))]
    own = {variable for u, free in zip(single.unknowns, varies, strict=True) if free for variable in u.variables}

    def left(free: bool) -> Calibration:
        unknowns = [u if free and v else _fixed(u, at) for u, v, at in zip(single.unknowns, varies, x, strict=True)]
        return calibrate(beats, network, unknowns, settings=settings, x0=x)

    as_fitted = left(False)
    refitted = left(True) if own else None
    if refitted is None:
        return HeldOut(beats.source, as_fitted.recordings[0].rms, {}, {})
    values = {name: value for name, value in refitted.values.items() if name in own}
    return HeldOut(beats.source, as_fitted.recordings[0].rms, refitted.recordings[0].rms, values)


def _fixed(unknown: Unknown, x: float) -> Unknown:
    return replace(unknown, low=float(x), high=float(x))
