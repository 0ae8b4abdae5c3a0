"""The documentation as a site: it is built without a warning, opens from a folder, and no link of it leads nowhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import arterial_fmu
from docs import live
from fmu_src import compiler

pytest.importorskip("material", reason="mkdocs-material is not installed")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return out


@pytest.mark.slow
def test_links(site: Path) -> None:
    """Every link leads to a file that is there, and to an anchor in it; all that a page loads lies beside it."""
    assert len(list(site.glob("*.html"))) > 20
    (site / "api").mkdir()
    (site / "api" / "arterial_fmu.html").touch()  # make docs writes the API
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "links.py", site], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("page", sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]), ids=lambda p: p.name)
def test_only_lists_have_numbered_items(page: Path) -> None:
    """A line that begins with "202. " would be an item of a list, without its number: items count up from 1."""
    last = 0
    for line in page.read_text(encoding="utf-8").splitlines():
        if number := re.match(r"\s*(\d+)\. ", line):
            assert int(number[1]) in (1, last + 1), line
            last = int(number[1])


@pytest.mark.slow  # pdoc reads all modules
def test_the_api_begins_with_the_public_names(tmp_path: Path) -> None:
    """The first page is arterial_fmu, in the order of a script; the index has it first, and internals folded.

    Without the coloured source below each name, which takes most of the time.
    """
    code = (
        "import functools, pdoc, runpy; "
        "pdoc.render.configure = functools.partial(pdoc.render.configure, show_source=False); "
        f"runpy.run_path({str(ROOT / 'docs' / 'api.py')!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    page = (tmp_path / "arterial_fmu.html").read_text(encoding="utf-8")
    found = re.findall(r'<section id="(\w+)"', page)
    assert found[:3] == ["load", "simulate", "simulate_periodic"] and set(arterial_fmu.__all__) <= set(found)
    index = (tmp_path / "index.html").read_text(encoding="utf-8")
    pages = re.findall(r'href="([a-z_/]+)\.html"', index)
    assert pages[:2] == ["arterial_fmu", "solver"] and index.index("<details>") < index.index("fitting/inference")


def test_what_is_wrong_is_said(tmp_path: Path) -> None:
    """A script of the network, a page and an anchor that are not there: a sentence each, exit code 1."""
    (tmp_path / "a.html").write_text(
        '<h1 id="x"><script src="https://here.example/s.js"></script><a href="b.html">b</a><a href="#y">y</a>'
        '<a href="a.html#x">x</a>'
    )
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "links.py", tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and done.stdout.splitlines() == [
        "a.html loads https://here.example/s.js, which is not beside it.",
        "a.html links to b.html, which is not there.",
        "a.html links to #y, where there is no such anchor.",
    ]


@pytest.mark.slow
def test_offline(site: Path) -> None:
    """No style has anything from the network, and the index of the search is a script."""
    styles = [file.read_text(encoding="utf-8") for file in site.rglob("*.css")]
    assert styles and not any("url(http" in text or "@import" in text for text in styles)
    assert (site / "search" / "search_index.js").is_file()


@pytest.mark.slow
def test_notebooks(site: Path) -> None:
    """Each notebook is a page with its figures."""
    for path in (ROOT / "examples" / "notebooks").glob("*.ipynb"):
        assert f'src="notebook-{path.stem}-' in (site / f"notebook-{path.stem}.html").read_text(encoding="utf-8")


def test_the_live_beat_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page says what is missing, and has neither data nor scripts; tests/test_live.py is about the rest."""
    monkeypatch.setattr(compiler, "ziglang", lambda target="": None)
    assert "pip install ziglang" in live.block() and "<" not in live.block()
    assert live.script() == ""
