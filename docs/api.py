"""The API of all packages as pages beside the site: ``python docs/api.py build/docs/api``."""

from __future__ import annotations

import sys
from pathlib import Path

import pdoc

import arterial_fmu
import discrepancy

# what scripts use first, then what is behind it
PACKAGES = ("arterial_fmu", "solver", "fitting", "discrepancy", "build_fmu", "fmu_src", "arterial_fmu.study")


def write(out: Path) -> None:
    """Write the pages into a folder, each with a way back to the site."""
    for package in (arterial_fmu, discrepancy):  # whose names are imported when they are asked for
        vars(package).update({name: getattr(package, name) for name in package.__all__})
    pdoc.render.configure(template_directory=Path(__file__).parent / "api_templates")
    pdoc.pdoc(*PACKAGES, output_directory=out)
    for page in out.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace("<code>~", "<code>"), encoding="utf-8")  # of :func:`~solver.periodic.start…`


if __name__ == "__main__":
    write(Path(sys.argv[1]))
