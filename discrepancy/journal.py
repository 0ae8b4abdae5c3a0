"""What a study has done so far, on disk: an interrupted one goes on where it was, and gives the same answer.

Every stage is one JSON file in ``<folder>/.state``, written whole. A stage counts only if it was made from the same
inputs: record, network, thresholds and software, whose hash is the journal's key.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from solver.files import write_whole

from .fits import Fit
from .name import Named, Naming, Problem
from .network import NetworkProblem
from .show import Gap, Run
from .terms import Term, Unknown

Result = TypeVar("Result")


class Journal:
    """The stages of one study in ``folder``; those of another study there are thrown away."""

    def __init__(self, folder: Path, inputs: Any) -> None:
        self.folder = folder / ".state"
        self.key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
        self.folder.mkdir(parents=True, exist_ok=True)

    def stage(
        self,
        name: str,
        compute: Callable[[], Result],
        encode: Callable[[Result], Any],
        decode: Callable[[Any], Result],
    ) -> Result:
        """The result of a stage: read if it is there, else computed and written."""
        path = self.folder / f"{name}.json"
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            data = {}
        if isinstance(data, dict) and data.get("key") == self.key:
            return decode(data["result"])
        result = compute()
        write_whole(path, json.dumps({"key": self.key, "result": encode(result)}))
        return result

    def close(self) -> None:
        """The study is done: its state is no longer needed."""
        shutil.rmtree(self.folder, ignore_errors=True)


# --- plain data and back; floats survive JSON bit for bit -------------------------------------------------------------


def encode_run(run: Run) -> dict[str, Any]:
    """A free run as plain data."""
    return {
        "X": [run.X.real.tolist(), run.X.imag.tolist()],
        "beats": {name: beat.tolist() for name, beat in run.beats.items()},
        "gap": [list(run.gap.total), {name: list(pair) for name, pair in run.gap.channels.items()}],
    }


def decode_run(data: Mapping[str, Any]) -> Run:
    """The free run of :func:`encode_run`."""
    total, channels = data["gap"]
    gap = Gap((total[0], total[1]), {name: (pair[0], pair[1]) for name, pair in channels.items()})
    X = np.array(data["X"][0]) + 1j * np.array(data["X"][1])
    return Run(X, {name: np.array(beat) for name, beat in data["beats"].items()}, gap)


def encode_naming(naming: Naming) -> dict[str, Any]:
    """A naming as plain data; its problem is made anew when it is read."""
    return {
        "verdict": naming.verdict,
        "reason": naming.reason,
        "base": _named(naming.base),
        "ranked": [_named(n) for n in naming.ranked],
        "members": len(naming.members),
        "columns": {label: column.tolist() for label, column in naming.columns.items()},
        "terms": [asdict(term) for term in naming.terms],
        "weights": _weights(naming.problem),
    }


def _weights(problem: Problem) -> list[Any]:
    """What a network's problem was weighted with at last; a bench needs nothing."""
    if not isinstance(problem, NetworkProblem):
        return []
    dt, *arrays = problem.weights
    return [dt, *([a.real.tolist(), a.imag.tolist()] for a in arrays)]


def decode_naming(data: Mapping[str, Any], problem: Problem) -> Naming:
    """The naming of :func:`encode_naming`, about ``problem`` weighted as it was."""
    base, ranked = _unnamed(data["base"]), tuple(_unnamed(each) for each in data["ranked"])
    if isinstance(problem, NetworkProblem):
        dt, error, *arrays = data["weights"]
        covariance, response = (np.array(a[0]) + 1j * np.array(a[1]) for a in arrays)
        problem = problem.restored(dt, np.array(error[0]), covariance, response)
    return Naming(
        data["verdict"],
        problem,
        base,
        ranked,
        ranked[: data["members"]],
        {label: np.array(column) for label, column in data["columns"].items()},
        tuple(_term(each) for each in data["terms"]),
        data["reason"],
    )


def _named(n: Named) -> dict[str, Any]:
    fit = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(n.fit).items()}
    fit |= {"terms": [asdict(t) for t in n.fit.terms], "unknowns": [asdict(u) for u in n.fit.unknowns]}
    return {**vars(n), "fit": fit}


def _unnamed(data: Mapping[str, Any]) -> Named:
    plain = data["fit"]
    arrays = {key: np.array(plain[key]) for key in ("x", "z", "J", "prior", "order", "signal")}
    arrays["J"] = arrays["J"].reshape(len(arrays["z"]), len(arrays["x"]))
    fit = Fit(
        _terms(plain["terms"]),
        _unknowns(plain["unknowns"]),
        **arrays,
        converged=plain["converged"],
        log_volume=plain["log_volume"],
    )
    return Named(**{**data, "fit": fit})


def _terms(data: Sequence[Mapping[str, Any]]) -> tuple[Term, ...]:
    return tuple(_term(each) for each in data)


def _term(data: Mapping[str, Any]) -> Term:
    starts = tuple(tuple(x) for x in data["starts"])
    return Term(data["effect"], data["place"], tuple(data["where"]), _unknowns(data["unknowns"]), starts)


def _unknowns(data: Sequence[Mapping[str, Any]]) -> tuple[Unknown, ...]:
    return tuple(Unknown(**{**each, "moves": tuple((v, step) for v, step in each["moves"])}) for each in data)
