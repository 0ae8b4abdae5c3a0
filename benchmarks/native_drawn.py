"""Networks drawn at random: the engine, and the FMU that needs no Python, against NumPy.

    python benchmarks/native_drawn.py [--examples 300] [--fmus 0] [--seed 1]

tests/drawn_networks.py draws: every effect, outlet and law, loops, several inlets, batches, parameters that change in
mid-run. Prints how many ran, how many failed with the same sentence, and the largest difference of an output by its
pulse; the exit code is 1 where one fails otherwise, or differs by more than 1e-10.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded

from fmu_src.variables.arteries_variables import INTERPOLATIONS
from tests.drawn_networks import Drawn, by_pulse, component_outputs, fmu_outputs, networks, outcome, outputs

EQUAL = 1e-10  # of each channel's pulse


def compare(one: Callable[[Drawn], Any], other: Callable[[Drawn], Any], examples: int, seed: int) -> tuple[str, bool]:
    """The line of a comparison, and whether all are equal; one, other : outputs, or what is said where they fail."""
    differences, alike, otherwise = list[float](), 0, list[str]()

    @seeded(seed)
    @settings(
        max_examples=examples, phases=[Phase.generate], database=None, deadline=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(networks())
    def draw(drawn: Drawn) -> None:
        nonlocal alike
        expected, found = one(drawn), other(drawn)
        if isinstance(expected, str) or isinstance(found, str):
            same = isinstance(expected, str) and isinstance(found, str) and expected == found
            alike += same
            otherwise.extend([] if same else [f"{drawn}: {found}, not {expected}"])
        else:
            differences.append(by_pulse(tuple(drawn.network.output_units()), found, expected))

    draw()
    largest = max(differences, default=0.0)
    drawn = len(differences) + alike + len(otherwise)
    said = f"{drawn} networks: {len(differences)} ran, largest difference {largest:.1e}; {alike} failed alike"
    return "\n".join([f"{said}, {len(otherwise)} otherwise", *otherwise]), largest < EQUAL and not otherwise


def engine(backend: str) -> Callable[[Drawn], Any]:
    """Outputs by a backend."""

    def run(drawn: Drawn) -> Any:
        found = outcome(outputs, drawn, backend)
        return found if isinstance(found, str) else found[0]

    return run


def way(drawn: Drawn) -> str:
    """One of the ways to interpolate the inflow, that of the number of segments."""
    return INTERPOLATIONS[len(drawn.network.segments) % len(INTERPOLATIONS)]


def main(
    examples: Annotated[int, typer.Option(help="Networks for the engine.")] = 300,
    fmus: Annotated[int, typer.Option(help="Networks for the FMU.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 1,
) -> None:
    """Draw, run and compare."""
    said, equal = compare(engine("numpy"), engine("native"), examples, seed)
    print(f"engine, {said}", flush=True)
    if fmus:
        parts = [lambda drawn, run=run: outcome(run, drawn, way(drawn)) for run in (component_outputs, fmu_outputs)]
        said, alike = compare(parts[0], parts[1], fmus, seed)
        print(f"FMU, {said}")
        equal = equal and alike
    raise typer.Exit(0 if equal else 1)


if __name__ == "__main__":
    typer.run(main)
