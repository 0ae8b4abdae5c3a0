"""benchmarks/mutations.py: what counts as caught, in a tree of one module and one test; and its faults fit."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutations import FAULTS, ROOT, Fault, caught, first_failure

DOUBLED = Fault("three times", "own.py", "2 * x", "3 * x", "own")


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module and a test that catches one of its faults, which needs no plugins of pytest."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    (tmp_path / "tests").mkdir()
    (tmp_path / "own.py").write_text("def doubled(x):\n    return 2 * x + 0\n")
    (tmp_path / "tests" / "test_own.py").write_text(
        "from own import doubled\n\n\ndef test_doubled():\n    assert doubled(2) == 4\n"
    )
    return tmp_path


def test_caught_and_missed(tree: Path) -> None:
    """A fault that a test feels, by its name, and one that none feels; the file is as before."""
    whole = (tree / "own.py").read_bytes()
    assert first_failure("own", tree) == ""
    assert caught(DOUBLED, tree) == "test_own.py::test_doubled"
    assert caught(DOUBLED._replace(old="+ 0", new="+ 0 * x"), tree) == ""
    assert (tree / "own.py").read_bytes() == whole


@pytest.mark.parametrize(
    ("tests", "new", "code"),
    [("gone", "3 * x", 4), ("own.py::test_gone", "3 * x", 4), ("own", "(3 * x", 2), ("empty", "3 * x", 5)],
)
def test_not_run_is_not_caught(tree: Path, tests: str, new: str, code: int) -> None:
    """No file, no such test, a module that cannot be imported, a file without tests: refused; the file is as before."""
    (tree / "tests" / "test_empty.py").write_text("")
    whole = (tree / "own.py").read_bytes()
    with pytest.raises(ValueError, match=f"{tests}: pytest ended with {code}"):
        caught(DOUBLED._replace(tests=tests, new=new), tree)
    assert (tree / "own.py").read_bytes() == whole


def test_faults_can_be_put_in() -> None:
    """What each replaces stands once in its file, and the tests that are to catch it are there."""
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault.what
        for name in fault.tests.split():
            file, _, test = name.partition("::")
            path = ROOT / "tests" / f"test_{file.removesuffix('.py')}.py"
            assert f"def {test}(" in path.read_text(encoding="utf-8") if test else path.is_file(), fault.what
