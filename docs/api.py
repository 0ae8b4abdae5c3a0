"""The API of all packages as pages beside the site: ``python docs/api.py build/docs/api``."""

from __future__ import annotations

import sys
from pathlib import Path

import pdoc

import discrepancy

PACKAGES = ("solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu", "build_fmu")


def write(out: Path) -> None:
    """Write the pages into a folder, each with a way back to the site."""
    vars(discrepancy)["discover"] = discrepancy.discover  # which is imported when it is asked for
    pdoc.render.configure(template_directory=Path(__file__).parent / "api_templates")
    pdoc.pdoc(*PACKAGES, output_directory=out)
    for page in out.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace("<code>~", "<code>"), encoding="utf-8")  # of :func:`~solver.start…`


if __name__ == "__main__":
    write(Path(sys.argv[1]))
