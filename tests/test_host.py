"""What an FMU says to a Python that cannot run it; hosts without numpy are in test_fmu_faults.py."""

from __future__ import annotations

import sys

import pytest

from fmu_src import host


def test_old_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence with version, place and what is needed."""
    monkeypatch.setattr(sys, "version_info", (3, 9, 2, "final", 0))
    with pytest.raises(ImportError) as refused:
        host.check()
    assert str(refused.value) == (
        f"this FMU runs in Python 3.9.2 in {sys.prefix}, but needs Python 3.10 or newer; let the host load that one."
    )


def test_no_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence with the interpreter that numpy is to be installed for."""
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(ImportError) as refused:
        host.check()
    version = ".".join(map(str, sys.version_info[:3]))
    assert str(refused.value).startswith(f"this FMU runs in Python {version} in {sys.prefix}, which has no numpy; ")
    assert str(refused.value).endswith(" -m pip install numpy.")


def test_this_python() -> None:
    """The one that runs the tests will do."""
    host.check()
