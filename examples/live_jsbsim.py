"""Start a JSBSim that flies by itself and follow it: python examples/live_jsbsim.py [SECONDS]

JSBSim runs in a process of its own. Its ball falls through 73 km at 6.1 km/s, and the file jsbsim_output.xml has it
send its state over UDP, ten times a second. The link computes the temperatures of a control point from it, and writes
them back as properties of the running JSBSim, which jsbsim_script.xml declares.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sim_heating.live import JSBSimProperties, LinkEngine, State, load_link, run_link

LIVE = Path(__file__).resolve().parents[1] / "scenarios" / "live"
FLIGHT = """
import sys, time
import jsbsim

fdm = jsbsim.FGFDMExec(None)
fdm.set_debug_level(0)
fdm.load_script(sys.argv[1])
fdm.set_output_directive(sys.argv[2])
for name, value in {"h-sl-ft": 240000.0, "vt-fps": 20000.0, "gamma-deg": -0.5, "psi-true-deg": 60.0}.items():
    fdm["ic/" + name] = value
fdm.run_ic()
begun = time.monotonic()
while fdm.get_sim_time() < float(sys.argv[3]):
    fdm.run()
    time.sleep(max(begun + fdm.get_sim_time() - time.monotonic(), 0.0))
print(f"within JSBSim: the surface is at {fdm['heating/V09T9527/surface_K']:.1f} K", file=sys.stderr)
"""
"""What the other process runs."""


async def follow(seconds: float) -> State:
    """Follow a flight of so many seconds; the last state."""
    link = load_link(LIVE / "jsbsim.toml")
    engine = LinkEngine(link)  # the first time on a machine, compilation takes a minute
    into_jsbsim = JSBSimProperties.of_link(link, engine.remarks.add)
    stop, next_s = asyncio.Event(), 0.0

    def show(state: State) -> None:
        nonlocal next_s
        if state.wall_s >= next_s or state.link.state == "ended":
            next_s = state.wall_s + 1.0
            surface = ", ".join(f"{name} {point.surface_K:.1f} K" for name, point in state.points.items())
            print(f"{state.link.state:8} {state.time_s or 0.0:6.1f} s  {surface}", flush=True)

    running = asyncio.create_task(run_link(engine, [into_jsbsim], on_state=show, stop=stop))
    await asyncio.sleep(0.5)  # the link is there before JSBSim, which states the names of its values once
    files = (str(LIVE / "jsbsim_script.xml"), str(LIVE / "jsbsim_output.xml"))
    with TemporaryDirectory() as folder:  # for a file that the ball writes
        flight = await asyncio.create_subprocess_exec(
            sys.executable, "-c", FLIGHT, *files, str(seconds), stdout=asyncio.subprocess.DEVNULL, cwd=folder
        )
        await flight.wait()
    stop.set()
    return await running


if __name__ == "__main__":
    last = asyncio.run(follow(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0))
    print(f"{last.link.damaged} damaged messages")
