"""The FMU in a host that knows nothing of Python: every function of FMI 2.0 for co-simulation, called from C."""

from __future__ import annotations

from pathlib import Path

import pytest
from c_host import Answer, CHost, Unpacked, unpack

H = 0.01  # s, communication step


@pytest.fixture(scope="module")
def fmu(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(fmus["coarse sheep"], tmp_path_factory.mktemp("sheep"))


@pytest.fixture(scope="module")
def other(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(fmus["mixed"], tmp_path_factory.mktemp("mixed"))


class Script:
    """Commands for one instance; ``read`` notes where the answers stand."""

    def __init__(self, fmu: Unpacked, i: int = 0, library: int = 0) -> None:
        self.fmu, self.i, self.step_number = fmu, i, 0
        self.commands = [f"library {library} {fmu.library}"] if i == library else []
        self.commands.append(fmu.instantiate(i, library))

    def begin(self) -> Script:
        self.commands += [f"setup {self.i} 0 10", f"enter {self.i}", f"exit {self.i}"]
        self.step_number = 0
        return self

    def steps(self, n: int) -> Script:
        """n steps with an inflow that rises."""
        for _ in range(n):
            k = self.step_number
            self.set("inlet.Q", (k + 1) * 1e-6)
            self.commands.append(f"step {self.i} {k * H!r} {H!r}")
            self.step_number += 1
        return self

    def set(self, name: str, value: float) -> Script:
        self.commands.append(f"setReal {self.i} {self.fmu.references[name]} {value!r}")
        return self

    def say(self, *words: object) -> Script:
        first, *rest = words
        self.commands.append(" ".join(map(str, [first, self.i, *rest])))
        return self

    def at(self, k: int) -> Script:
        """The state that is restored stands after k steps."""
        self.step_number = k
        return self

    def read(self) -> Script:
        """Read every output."""
        return self.say("getReal", *(self.fmu.references[name] for name in self.fmu.outputs))


def tables(host: CHost, *scripts: Script) -> list[list[float]]:
    """What each ``read`` answered, in order; every call must have succeeded."""
    commands = [command for script in scripts for command in script.commands]
    run = host.run(commands)
    assert (run.code, run.errors) == (0, "")
    bad = [(c, a) for c, a in zip(commands, run.answers, strict=True) if a.status != "ok" or a.log]
    assert bad == []
    reads = [a for c, a in zip(commands, run.answers, strict=True) if c.startswith("getReal") and len(c.split()) > 5]
    return [answer.values for answer in reads]


def test_versions_and_types(c_host: CHost, fmu: Unpacked) -> None:
    """Version and platform; each type of value is read and set as what it is, and refused as another."""
    law, E = fmu.references["network.elastic_law"], fmu.references["CA.E"]
    script = Script(fmu).say("getInteger", law).say("setInteger", law, 2).say("getInteger", law).say("getReal", E)
    for function in ("getBoolean", "getString"):
        script.say(function, E)
    script.say("getInteger", E).say("getReal", law).say("setInteger", law, 9).say("setReal", E, 2e6).say("getReal", E)
    run = c_host.run([*script.commands, "free 0"])
    assert run.code == 0
    assert run[0] == Answer("ok", "2.0 default", ())
    assert [answer.status for answer in run.answers[2:]] == ["ok"] * 4 + ["fatal"] * 5 + ["ok"] * 3
    assert [run[k].rest for k in (2, 4)] == ["1", "2"]
    assert run[12].values == [2e6]
    assert "network.elastic_law = 9: must be" in run[10].log[0]


def test_reset_is_a_fresh_instance(c_host: CHost, fmu: Unpacked) -> None:
    """After reset, and in a second instance beside, the same run gives the same bits."""
    first = Script(fmu).begin().steps(3).read().say("terminate").say("reset").begin().steps(3).read()
    second = Script(fmu, 1).begin().steps(3).read()
    found = tables(c_host, first, second, Script(fmu, 2).begin().steps(2).read())
    assert found[0] == found[1] == found[2] != found[3]


def test_two_instances_and_two_fmus_do_not_touch(c_host: CHost, fmu: Unpacked, other: Unpacked) -> None:
    """Steps taken in turn by two instances of one FMU and by another FMU: the bits of each run alone."""
    alone = tables(c_host, Script(fmu).begin().steps(4).read(), Script(other, 1, 1).begin().steps(4).read())
    scripts = [Script(fmu).begin(), Script(fmu, 2).begin(), Script(other, 1, 1).begin()]
    beginning = [list(script.commands) for script in scripts]
    for script in scripts:
        script.commands.clear()
        script.steps(4)
    turns = zip(*(zip(s.commands[::2], s.commands[1::2], strict=True) for s in scripts), strict=True)
    mixed = [command for turn in turns for pair in turn for command in pair]
    for script in scripts:
        script.commands.clear()
        script.read()
    joint = Script(fmu)
    joint.commands = [c for part in (*beginning, mixed, *(s.commands for s in scripts)) for c in part]
    assert tables(c_host, joint) == [alone[0], alone[0], alone[1]]


def test_saved_state(c_host: CHost, fmu: Unpacked, tmp_path: Path) -> None:
    """Save, go on, restore, go on: equal bits; the same in another instance, and in a new process."""
    blob = tmp_path / "state.bin"
    first = Script(fmu).begin().steps(3).say("save", 0).say("write", 0, blob).steps(3).read()
    first.set("CA.E", 2e6).steps(2).say("restore", 0).at(3).steps(3).read()
    second = Script(fmu, 1).begin().steps(1).say("read", 1, blob).say("restore", 1).at(3).steps(3).read()
    second.say("forget", 1).say("terminate").say("free")
    found = tables(c_host, first.say("forget", 0).say("terminate").say("free"), second)
    third = Script(fmu).begin().say("read", 0, blob).say("restore", 0).at(3).steps(3).read().say("forget", 0)
    assert found[0] == found[1] == found[2] == tables(c_host, third)[0]


@pytest.fixture(scope="module")
def undisturbed(c_host: CHost, fmu: Unpacked) -> list[float]:
    """What two steps give."""
    return tables(c_host, Script(fmu).begin().steps(2).read())[0]


@pytest.mark.parametrize(
    "damage",
    [
        "short",
        "foreign",
        pytest.param("changed", marks=pytest.mark.slow),
        pytest.param("empty", marks=pytest.mark.slow),
    ],
)
def test_a_state_that_is_none(
    c_host: CHost, fmu: Unpacked, other: Unpacked, undisturbed: list[float], tmp_path: Path, damage: str
) -> None:
    """Bytes cut off, changed, missing, or of another FMU: refused with a sentence, and the instance is as it was."""
    blob, whole = tmp_path / "state.bin", tmp_path / "whole.bin"
    source = other if damage == "foreign" else fmu
    c_host.run(Script(source).begin().steps(2).say("save", 0).say("write", 0, whole).commands)
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 1 if damage == "changed" else 0
    blob.write_bytes({"short": content[:-1], "empty": b""}.get(damage, content))
    after = Script(fmu).begin().steps(2).say("read", 3, blob).read()
    run = c_host.run([*after.commands, "free 0"])
    assert run.code == 0
    assert run[-3].status in ("error", "fatal")
    assert [answer.log for answer in run.answers[:-3] + run.answers[-2:] if answer.log] == []
    (message,) = run[-3].log
    assert {"empty": "not a saved state", "foreign": "restore it there"}.get(damage, "incomplete or damaged") in message
    assert run[-2].values == undisturbed
