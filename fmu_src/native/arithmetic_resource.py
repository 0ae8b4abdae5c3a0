"""The resource of a heart or a body that needs no Python: its three programs (:mod:`solver.tracing.arithmetic`) in
``resources/arterial.bin``. Not part of the code of other FMUs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from solver.errors import InputError
from solver.lumped.component import Arithmetic
from solver.tracing.arithmetic import Recorded, Requirement, recorded
from solver.tracing.program import Shared

from ..variables.variable import Variable
from .arrays import Texts, file_of, integers, tables

Array = np.ndarray

_NUMBERS = 4  # at most, of a sentence
_FORMATS = re.compile(r"%%|%(?:\.1?\d)?g")  # that native/fmu/arithmetic.c knows


def resource(component: Arithmetic, table: Sequence[Variable]) -> bytes:
    """The file, its GUID still open (:func:`~fmu_src.native.arrays.with_guid`).

    Raises ValueError for a sentence of a requirement that C cannot print.
    """
    shared, texts = Shared(), Texts()
    given = [variable for variable in table if variable.causality != "output"]
    choices = {variable.name: variable.choices for variable in given if variable.choices}
    programs = recorded(component, [variable.name for variable in given], choices, shared)
    arrays = tables(table, texts, n_programs=len(programs), n_arithmetic=programs[0].n_state)
    arrays |= {"index": shared.index.all(), "numbers": shared.constants.all()}
    return file_of(arrays, texts, [array for program in programs for array in _program(program, texts)])


def _program(recorded: Recorded, texts: Texts) -> Iterator[Array]:
    """Counts and places, code, where phases begin; and nothing more."""
    p, at = recorded.program, recorded.program.address
    numbers = [p.n_fixed, p.n_work, len(recorded.loops), len(recorded.requirements)]
    numbers += [at.get(name, -1) for name in ("values", "state", "t", "h", "direction")]
    numbers += [at["next_state"], at["outputs"]]
    for k, size in enumerate(recorded.loops):
        numbers += [size, *(at[f"{name}_{k}"] for name in ("begin", "before", "after"))]
    for k, must in enumerate(recorded.requirements):
        _check(must)
        places = [at[f"number_{k}_{i}"] for i in range(must.numbers)]
        numbers += [must.phase, at[f"required_{k}"], texts.at(must.sentence), *places, *[0] * (_NUMBERS - len(places))]
    yield integers(numbers)
    yield from (p.code, p.begin)
    yield from [integers([])] * 3


def _check(must: Requirement) -> None:
    """Raise ValueError where the sentence has another format than %g and %.6g, or not one for each number."""
    formats = [found for found in _FORMATS.findall(must.sentence) if found != "%%"]
    if "%" in _FORMATS.sub("", must.sentence):
        raise InputError(f"{must.sentence!r}: in an FMU without Python only %g, %.0g to %.19g and %% may be in it.")
    if not len(formats) == must.numbers <= _NUMBERS:
        raise InputError(
            f"{must.sentence!r}: has {len(formats)} places for {must.numbers} numbers; an FMU without Python needs one "
            f"for each, and takes up to {_NUMBERS}."
        )
