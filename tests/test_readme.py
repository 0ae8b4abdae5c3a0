"""Snippets of README.md, CONTRIBUTING.md and docs/ run, here and in test_snippets_of_*.py; tables and links hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from snippets import DOCUMENTS, PAGES, ROOT, Lines, cases, documents, run_snippet, snippets, text_of

from arterial_fmu.cli.commands import COMMANDS, load
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Settings, read_network
from solver.laws import catalogue
from solver.laws.outlets import OUTLETS
from solver.network.description import Fluid, Inlet, Junction, Segment
from solver.network.files import loads
from solver.quantities.quantity import quantities


@pytest.mark.parametrize("document", PAGES)
def test_there_aresnippets(document: str) -> None:
    """A document with snippets is in the list above, and has as many as it says, or more."""
    kinds = [kind for kind, _ in snippets(document)]
    python, shell = DOCUMENTS.get(document, (0, 0))
    assert kinds.count("python") >= python and kinds.count("sh") >= shell
    assert document in DOCUMENTS or not kinds


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, lines: Lines) -> dict[str, Path]:
    """A directory a document; that of README.md with what ``make demo`` has built."""
    paths = {document: tmp_path_factory.mktemp("snippets") for document in documents(__file__)}
    lines.run("arterial-fmu build sheep --out dist", paths["README.md"])
    return paths


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize(("document", "number"), cases(__file__))
def test_snippet(folders: dict[str, Path], lines: Lines, document: str, number: int) -> None:
    run_snippet(folders[document], lines, document, number)


def _anchors(document: str) -> set[str]:
    """The anchors of a page's titles, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text_of(document), flags=re.DOTALL), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("document", PAGES)
def test_links(document: str) -> None:
    """Every link of a page leads to a file or folder that is there, and to a title that is in it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(document)):
        if target.startswith("https://"):
            continue
        file, _, anchor = target.partition("#")
        path = (ROOT / document).parent / file if file else ROOT / document
        assert path.exists(), target
        assert not anchor or anchor in _anchors(path.resolve().relative_to(ROOT).as_posix()), target


def test_network_file_examples() -> None:
    """The complete TOML example of docs/network-file.md is a network."""
    blocks = re.findall(r"```toml\n(.*?)```", text_of("docs/network-file.md"), flags=re.DOTALL)
    blocks = [block for block in blocks if "[inlet]" in block]
    assert blocks
    for block in blocks:
        assert loads(block, "docs/network-file.md").segments
    assert read_network(ROOT / "solver" / "networks" / "sheep.toml").name == "sheep"


def test_network_file_keys() -> None:
    """docs/network-file.md has a row for every key that carries a number."""
    kinds = (Segment, Fluid, Inlet, Junction, *OUTLETS)
    keys = {key for kind in kinds for key in quantities(kind)}
    keys |= {key for owner in ("segment", "fluid", "channel") for key in catalogue.terms_of(owner)}
    rows = re.findall(r"^\|.*\|$", text_of("docs/network-file.md"), flags=re.MULTILINE)
    assert keys <= set(re.findall(r"`(\w+)`", "\n".join(rows)))


def test_numbers_of_choices(sheep: Network) -> None:
    """The numbers that docs/fmu.md gives to the choices of an Enumeration are those of the FMU: hosts set them."""
    for v in variable_table(sheep, Settings()):
        if v.choices:
            group, _, key = v.name.rpartition(".")
            row = rf"^\| `{group}\.[^|]*{key}`[^|]* \| fixed parameter \| Enumeration \| .*$"
            (row,) = re.findall(row, text_of("docs/fmu.md"), flags=re.MULTILINE)
            numbered = [f"{i} `{choice}`" for i, choice in enumerate(v.choices, start=1)]
            assert all(each in row for each in numbered), v.name


def test_fmu_variables(sheep: Network) -> None:
    """The table of docs/fmu.md has every variable of the FMU, and in the kind of its row."""
    known = {}
    for names, kind in re.findall(r"^\| (`.*?) \| ([\w ]+) \|", text_of("docs/fmu.md"), flags=re.MULTILINE):
        first, *others = re.findall(r"`([^`]+)`", names)
        stem = first.rpartition(".")[0]
        known |= dict.fromkeys((first, *(stem + other for other in others)), kind)
    patterns = {re.sub(r"<\w+>", r"\\w+", name.replace(".", r"\.")): kind for name, kind in known.items()}
    for v in variable_table(sheep, Settings()):
        kinds = [kind for pattern, kind in patterns.items() if re.fullmatch(pattern, v.name)]
        expected = f"{v.variability} parameter" if v.causality == "parameter" else v.causality
        assert [known.get(v.name)] == [expected] or kinds == [expected], v.name


def test_every_option_is_documented() -> None:
    """Every option of every command is on a page."""
    text = "".join(map(text_of, PAGES))
    for command in map(load, COMMANDS):
        names = command.list_commands(None) if hasattr(command, "list_commands") else ()
        for each in (command, *(command.get_command(None, name) for name in names)):
            options = [o for p in each.params for o in (*p.opts, *p.secondary_opts) if o.startswith("--")]
            assert not [o for o in options if o != "--help" and not re.search(f"{o}(?![\\w-])", text)], each.name
