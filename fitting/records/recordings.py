"""Several recordings of one animal: their files, their names, and sentences about them and about what is left of their
channels, in the units that people read.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from itertools import chain, count
from pathlib import Path

from solver.errors import InputError
from solver.quantities.legible import number
from solver.quantities.units import of_signal


def check_readable(*paths: str | os.PathLike[str]) -> None:
    """Raise InputError if one of these files of a recording cannot be opened."""
    for path in paths:
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(f"{path}: cannot be read (not a regular file); give the name of a CSV file.")
        try:
            open(path, "rb").close()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path.") from None


def labels_of(sources: Sequence[str | os.PathLike[str]]) -> list[str]:
    """Names of recordings: those of their files without folder and suffix, with a number where two are the same."""
    labels: list[str] = []
    for source in sources:
        stem = Path(source).stem
        numbered = (f"{stem}-{i}" for i in count(2))
        labels.append(next(label for label in chain([stem], numbered) if label not in labels))
    return labels


def check_one(beside: Sequence[object] | None, recordings: int) -> None:
    """Raise InputError if further files of one recording are given with several recordings."""
    if beside and recordings > 1:
        raise InputError("--with: adds files to one recording, and there are several; join its files before.")


def not_judged(path: str | os.PathLike[str], error: Exception) -> str:
    """The sentence for a held-out recording that cannot be used; the result stands without it."""
    source = os.fspath(path)
    return f"{source}: it was held out and cannot be compared: {str(error).removeprefix(f'{source}: ')}"


_MOST = 4  # channels by name


def sizes(rms: Mapping[str, float], loud: Mapping[str, float] | None = None) -> str:
    """ "1.3 mmHg of Ao.P, 2.1 mmHg of Pe.P"; rms : by channel [SI]. Of many channels, those of the largest ``loud``."""
    texts = [f"{size_text(name, rms[name])} of {name}" for name in loudest(rms, loud)]
    return ", ".join(texts) + (f" and {rest} more" if (rest := len(rms) - len(texts)) else "")


def changes(before: Mapping[str, float], after: Mapping[str, float], loud: Mapping[str, float] | None = None) -> str:
    """ "Ao.P from 1.3 to 0.9 mmHg, Pe.P still 2.1 mmHg"."""
    texts = []
    for name in loudest(before, loud):
        first, last = size_text(name, before[name]), size_text(name, after[name])
        number_alone = size_text(name, before[name], unit=False)
        texts.append(f"{name} still {last}" if first == last else f"{name} from {number_alone} to {last}")
    return ", ".join(texts) + (f" and {rest} more" if (rest := len(before) - len(texts)) else "")


def loudest(rms: Mapping[str, float], loud: Mapping[str, float] | None = None) -> list[str]:
    """The channels that are shown, in the order in which they stand."""
    most = sorted(rms, key=lambda name: -(loud or {}).get(name, 0.0))[:_MOST]
    return [name for name in rms if name in most]


def size_text(name: str, rms: float, unit: bool = True) -> str:
    """The rms [SI] of a channel: "1.3 mmHg"."""
    display, factor = of_signal(name)
    return f"{number(factor * rms, 2)} {display}" if unit else number(factor * rms, 2)
