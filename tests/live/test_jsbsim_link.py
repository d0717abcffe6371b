"""A JSBSim in a process of its own is a source by its own UDP socket, and takes estimates by its own input socket."""

from __future__ import annotations

import asyncio
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.live.outputs.jsbsim_properties import FIELDS, JSBSimProperties
from sim_heating.live.outputs.published import Published
from sim_heating.live.spec import Link, make_link, replayed
from sim_heating.live.state import PointState, State
from tests.live.links import free_port, link
from tests.support.paths import PRACTICE, ROOT

JSBSIM = {"kind": "jsbsim", "transport": "udp", "port": 5501}
NAMES = [f"P{k}" for k in range(16)]
FOLDERS = {name: f"heating/{name}" for name in NAMES}


@pytest.mark.thorough
def test_running_jsbsim_is_followed_by_its_socket_and_gets_the_estimates(capfd):
    pytest.importorskip("jsbsim")
    import importlib.util

    spec = importlib.util.spec_from_file_location("live_jsbsim", ROOT / "examples" / "live_jsbsim.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    asyncio.run(example.follow(0.5))  # on a machine where it is compiled first, the estimate comes after the flight
    capfd.readouterr()
    last = asyncio.run(example.follow(5.0))
    assert last.link.state == "ended"
    assert last.link.damaged == 0
    assert last.time_s == pytest.approx(5.0, abs=0.3)
    assert last.conditions["altitude_m"] == pytest.approx(240000.0 * 0.3048, rel=0.01)
    assert last.conditions["velocity_m_s"] == pytest.approx(6096.0, rel=0.01)
    surface_K = last.points["V09T9527"].surface_K
    assert surface_K > 300.0  # it began at 290 K and is heated
    (within_K,) = re.findall(r"within JSBSim: the surface is at ([0-9.]+) K", capfd.readouterr().err)
    assert 300.0 < float(within_K) <= surface_K + 0.1  # a state of a moment before, to a tenth
    assert [line for line in last.link.messages if "does not set" in line] == []


# Against JSBSim's own input socket -----------------------------------------------------------------------------------


@contextmanager
def flying(folder: Path, port: int, declared: list[str], begin_s: float = 0.0) -> Iterator[Callable[[str], float]]:
    """A JSBSim within this process that runs, with properties; gives the value of one."""
    jsbsim = pytest.importorskip("jsbsim")
    script = folder / "script.xml"
    properties = "".join(f'<property value="-1"> {name} </property>' for name in declared)
    script.write_text(
        f'<?xml version="1.0"?><runscript name="test"><use aircraft="ball" initialize="reset00"/><input port="{port}"/>'
        f'<run start="0.0" end="100000.0" dt="0.01">{properties}</run></runscript>'
    )
    done = threading.Event()
    ready = threading.Event()
    running = [jsbsim.FGFDMExec(None)]

    def fly() -> None:
        time.sleep(begin_s)
        (fdm,) = running
        fdm.set_debug_level(0)
        fdm.set_output_path(str(folder))  # of a file that its ball writes
        fdm.load_script(str(script))
        fdm.run_ic()
        ready.set()
        while not done.is_set():
            fdm.run()
            time.sleep(0.002)

    thread = threading.Thread(target=fly)
    thread.start()
    try:
        if begin_s == 0.0:
            assert ready.wait(20.0)
        yield lambda name: running[0][name]
    finally:
        done.set()
        thread.join()
        running.clear()  # closes its socket


def state(number: int, names: list[str] = NAMES) -> State:
    """A state of which everything changes with its number; the margin is known of the first control point alone."""
    points = {
        name: PointState(
            1000.0 + number + k / 16, 5.0, 300.0 + number, 1.0, ratio=0.5, ratio_sigma=0.01,
            margin_K=None if k else 12.5,
        )
        for k, name in enumerate(names)
    }  # fmt: skip
    return State(number, 0.1 * number, 0.0, points=points)


async def publish_until(output: JSBSimProperties, is_done: Callable[[], bool], first: int = 1) -> int:
    """Publish states until something holds, at most 20 s; the number of the last one."""
    for number in range(first, first + 400):
        output.publish(Published(state(number)))
        await asyncio.sleep(0.05)
        if is_done():
            return number
    raise AssertionError("it never was so")


@pytest.mark.thorough
def test_sixteen_points_are_written_and_what_is_not_declared_is_one_remark(tmp_path):
    port, said = free_port(), []
    declared = ["heating/time_s", *(f"heating/{name}/{field}" for name in NAMES for field in FIELDS[:4])]

    async def main() -> None:
        output = JSBSimProperties("127.0.0.1", port, "heating", FOLDERS, said.append)
        await output.start()
        number = await publish_until(output, lambda: value("heating/P15/surface_K") > 0.0)
        output.publish(Published(state(number + 1)))
        await output.stop()  # with the last state
        written.update({name: value(name) for name in declared} | {"last": number + 1})

    written: dict[str, float] = {}
    with flying(tmp_path, port, declared) as value:
        asyncio.run(main())
        first = written.copy()
        asyncio.run(main())  # a link that is started again is let in
    last = state(int(first["last"]))
    assert first["heating/time_s"] == pytest.approx(last.time_s)
    for name, point in last.points.items():
        for field in FIELDS[:4]:
            assert first[f"heating/{name}/{field}"] == pytest.approx(getattr(point, field), rel=1e-8)
    assert len(said) == 2  # one of each link
    assert re.search(r"does not set heating/P0/ratio and 32 more \(Unknown property\); declare", said[0])


@pytest.mark.thorough
def test_late_and_leaving_jsbsim_is_a_remark_and_blocks_nothing(tmp_path):
    port, said = free_port(), []

    async def main() -> None:
        output = JSBSimProperties("127.0.0.1", port, "heating", FOLDERS, said.append)
        await output.start()
        began = time.monotonic()
        for number in range(100):
            output.publish(Published(state(number)))
        assert time.monotonic() - began < 0.5
        with flying(tmp_path, port, ["heating/P3/surface_K"], begin_s=1.5) as value:
            await asyncio.sleep(2.0)
            await publish_until(output, lambda: any("does not set" in line for line in said), first=100)
            assert value("heating/P3/surface_K") >= 1100.0
        await publish_until(output, lambda: any("has gone" in line for line in said))
        began = time.monotonic()
        await output.stop()
        assert time.monotonic() - began < 1.0

    asyncio.run(main())
    absent, lacking, gone = said
    assert re.search(rf"port {port}, takes no connection \(.*\); it is tried again", absent)
    assert "does not set heating/time_s and 96 more" in lacking
    assert gone.endswith(f"port {port}, has gone; it is tried again")


# What a link file may ask for ----------------------------------------------------------------------------------------


def with_output(source: dict, points: list[str] | None = None, **jsbsim: object) -> Link:
    keys = {} if points is None else {"control_points": points}
    return link(source, output={"jsbsim": jsbsim}, **keys)


def test_properties_are_in_a_folder_of_each_control_point():
    made = with_output(JSBSIM, ["V09T9527", "NOSECAP"], prefix="tps/heating/")
    assert made.property_folders == {"V09T9527": "tps/heating/V09T9527", "NOSECAP": "tps/heating/NOSECAP"}
    assert link(JSBSIM).property_folders == {}


def test_record_names_become_property_names_and_clashes_are_refused(tmp_path):
    def of_records(*names: str) -> Link:
        places = []
        for k, name in enumerate(names):
            places.append(str(shutil.copytree(PRACTICE / "p06", tmp_path / f"{name} {k}")))
            declared = Path(places[-1]) / "record.toml"
            text = re.sub(r"(?m)^control_point = .*$", f'control_point = "{name}"', declared.read_text())
            declared.write_text(text)
        data = {"format": "link/1", "records": places, "source": [JSBSIM], "output": {"jsbsim": {}}}
        return make_link(data, tmp_path / "link.toml")

    made = of_records("left wing", "3 Ä")
    assert made.property_folders == {"left wing": "heating/left_wing", "3 Ä": "heating/_3__"}
    with pytest.raises(InputError, match=r"\[output\.jsbsim\]: .*tip_1 and tip 1 would both be heating/tip_1 in"):
        of_records("tip_1", "tip 1")


def test_a_replay_of_a_record_writes_into_no_jsbsim():
    again = replayed(with_output(JSBSIM), PRACTICE / "p06", 0.0)
    assert again.declared.output.jsbsim is None
    assert again.property_folders == {}


@pytest.mark.parametrize(
    ("source", "jsbsim", "problem"),
    [
        ({"kind": "json-lines"}, {}, '[output.jsbsim]: goes with a [[source]] of kind = "jsbsim"'),
        (JSBSIM, {"prefix": "9 lives"}, "prefix"),
        (JSBSIM, {"port": 0}, "port"),
    ],
)
def test_what_cannot_be_written_to_is_refused_in_one_line(source, jsbsim, problem):
    with pytest.raises(InputError) as refused:
        with_output(source, **jsbsim)
    (line,) = refused.value.problems
    assert problem in line.replace("`", "")
