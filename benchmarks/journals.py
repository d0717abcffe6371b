"""Links under hostile use: damaged journals, kills, other links, hostile packets, half-open connections, full disks.

    python -m benchmarks journals
    python -m benchmarks.journals --small

What must hold: nothing is lost but what was damaged, which is reported, nobody sees a traceback, and no reading gets a
wrong unit.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np

from benchmarks.measure import Figure, save, table
from sim_heating.base.errors import InputError
from sim_heating.inputs.record import load_record
from sim_heating.live.recording.journal import BODY, HEAD, MARK, NAME, Journal, damage_of, read_journal

SEED = 48
LINK = {"format": "link/1", "vehicle": "orbiter"}
PLACE = Path("scenarios/live/link.toml")
FRAME = {
    "altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0, "elevon_deg": 1.0,
    "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5,
}  # fmt: skip
POINT = "V09T9527"
EVERY_S = 0.1
"""Flight time between two messages [s]."""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Sizes:
    """journals : that are damaged;  kills : of one link, which is started again;  packets : hostile ones"""

    journals: int = 2000
    kills: int = 100
    packets: int = 20_000


SMALL = Sizes(journals=200, kills=4, packets=2000)


# Damaged journals ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stretch:
    """Bytes of a journal that stay together: the header, a mark, or a message with its body."""

    begin: int
    end: int
    body: bytes | None


def written(folder: Path, rng: np.random.Generator, *, is_end: bool) -> tuple[bytes, list[Stretch]]:
    """A journal of random messages of text and of numbers, as bytes and as stretches."""
    journal = Journal(folder / NAME, LINK, PLACE, fsync_s=60.0)
    for k in range(int(rng.integers(1, 120))):
        is_text = rng.random() < 0.6
        text = json.dumps({"time_s": k, **dict.fromkeys("abcdef"[: int(rng.integers(0, 7))], float(rng.random()))})
        body = text.encode() if is_text else rng.integers(0, 256, int(rng.integers(0, 400)), np.uint8).tobytes()
        journal.append(body, source=int(rng.integers(0, 3)))
    journal.close(is_end=is_end)
    data = (folder / NAME).read_bytes()
    begin = data.index(b"\n") + 1
    stretches = [Stretch(0, begin, None)]
    while begin < len(data):
        end = begin + HEAD.size + HEAD.unpack_from(data, begin)[0]
        source, content = BODY.unpack_from(data, begin + HEAD.size)[1], data[begin + HEAD.size + BODY.size : end]
        stretches.append(Stretch(begin, end, None if source == MARK else content))
        begin = end
    return data, stretches


def damaged(data: bytes, rng: np.random.Generator) -> tuple[bytes, list[tuple[int, int]]]:
    """The bytes of a journal damaged at random, and the stretches of the original that were touched."""
    kind, touched = int(rng.integers(0, 7)), list[tuple[int, int]]()
    changed = bytearray(data)
    at = int(rng.integers(0, len(data)))
    long = int(min(rng.choice([1, 8, 64, 512, 4096]), len(data) - at))
    if kind <= 1:  # bits flip
        for place in rng.integers(0, len(data), 1 if kind == 0 else int(rng.integers(2, 9))).tolist():
            changed[place] ^= 1 << int(rng.integers(0, 8))
            touched.append((place, place + 1))
    elif kind == 2:  # a block of zeros
        changed[at : at + long] = bytes(long)
        touched.append((at, at + long))
    elif kind == 3:  # a block of anything
        changed[at : at + long] = rng.integers(0, 256, long, np.uint8).tobytes()
        touched.append((at, at + long))
    elif kind == 4:  # bytes that are missing
        del changed[at : at + long]
        touched.append((at, at + long))
    elif kind == 5:  # bytes that do not belong there
        changed[at:at] = rng.integers(0, 256, long, np.uint8).tobytes()
        touched.append((at, at))
    else:  # cut off
        del changed[at:]
        touched.append((at, len(data)))
    return bytes(changed), touched


def _is_whole(stretch: Stretch, data: bytes, changed: bytes, touched: Sequence[tuple[int, int]]) -> bool:
    """Whether a stretch is in the damaged journal as it was written."""
    same_size = len(data) == len(changed)
    if same_size:
        return changed[stretch.begin : stretch.end] == data[stretch.begin : stretch.end]
    return all(end <= stretch.begin or begin >= stretch.end for begin, end in touched)


def damaged_journals(count: int, seed: int = SEED) -> dict[str, int]:
    """What became of journals that were damaged at random.

    returns : number of journals; of messages that were damaged; of those that were lost beside these, that were read
              and never sent, that an unreported damage took; of journals that were gone on with, and of those of which
              the next link lost something, or kept no copy; of errors other than a refusal in one line
    """
    tally = dict.fromkeys(
        (
            "journals",
            "damaged",
            "lost",
            "never sent",
            "untold",
            "resumed",
            "lost by the next link",
            "no copy",
            "errors",
        ),
        0,
    )
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        with TemporaryDirectory() as folder:
            place = Path(folder)
            data, stretches = written(place, rng, is_end=bool(number % 2))
            changed, touched = damaged(data, rng)
            (place / NAME).write_bytes(changed)
            kept = [s for s in stretches if _is_whole(s, data, changed, touched)]
            wanted = [s.body for s in kept if s.body is not None]
            tally["journals"] += 1
            tally["damaged"] += sum(s.body is not None for s in stretches) - len(wanted)
            _judge(place, wanted, len(kept) < len(stretches) and not _cut_between(stretches, touched, data), tally)
            _judge_resumed(place, wanted, changed, tally)
    return tally


def _cut_between(stretches: Sequence[Stretch], touched: Sequence[tuple[int, int]], data: bytes) -> bool:
    """Whether whole messages are missing, which no reader can know."""
    ends = {s.end for s in stretches} | {0}
    return all(begin in ends and end in ends for begin, end in touched)


def _judge(place: Path, wanted: Sequence[bytes], is_damaged: bool, tally: dict[str, int]) -> None:
    try:
        found = [entry.body for entry in read_journal(place)]
        told = damage_of(place)
    except InputError as error:
        found, told = [], list(error.problems)
        tally["errors"] += len(error.problems) != 1
    except Exception:
        tally["errors"] += 1
        return
    tally["lost"] += missing(wanted, found)
    tally["never sent"] += missing(found, wanted)
    tally["untold"] += is_damaged and not told


def _judge_resumed(place: Path, wanted: Sequence[bytes], changed: bytes, tally: dict[str, int]) -> None:
    try:
        journal = Journal(place / NAME, LINK, PLACE, fsync_s=60.0)
    except InputError as error:  # ended, or nothing tells which link wrote it
        tally["errors"] += len(error.problems) != 1 or (place / NAME).read_bytes() != changed
        return
    except Exception:
        tally["errors"] += 1
        return
    journal.append(b"after")
    journal.close(is_end=True)
    tally["resumed"] += 1
    found = [entry.body for entry in read_journal(place)]
    tally["lost by the next link"] += missing([*wanted, b"after"], found) + missing(found, [*wanted, b"after"])
    if journal.notes:
        copies = [p.read_bytes() for p in place.glob("journal.damaged-*.bin")]
        tally["no copy"] += copies != [changed]


def missing(wanted: Sequence[bytes], found: Sequence[bytes]) -> int:
    """How many of one sequence are not in another one, in its order."""
    rest, count = iter(found), 0
    there = set(found)
    for body in wanted:
        if body not in there or not any(body == other for other in rest):
            count += 1
            rest = iter(found)
    return count


# A link in a process of its own --------------------------------------------------------------------------------------

TCP = 'kind = "json-lines"\ntransport = "tcp-server"\n'
"""A source of lines that others send."""


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def take_signals() -> None:
    """In a process to be started: take ending signals, which a shell lets its background processes ignore."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


class Running:
    """The command `live` in another process, with a source over TCP.

    link, sensor : name of its file, and the line of TOML that states the unit of its sensor
    source       : table of TOML, by default lines that others send to the port
    options      : of the command, by default no page;  limit : of the process, as `ulimit` takes it
    out          : of its results, by default in the folder;  environment : variables that are added
    """

    def __init__(
        self, folder: Path, port: int, link: str = "link.toml", sensor: str = 'unit = "K"', *, source: str = TCP,
        options: Sequence[str] = ("--headless",), limit: str = "", out: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self.out = folder / "out" if out is None else out
        text = f'format = "link/1"\nvehicle = "orbiter"\ncontrol_points = ["{POINT}"]\n'
        text += f"[[source]]\n{source}port = {port}\n"
        text += f'[[sensor]]\nsensor = "{POINT}"\nfield = "tc"\n{sensor}\n[estimate]\nparameters = ["ratio.scale"]\n'
        (folder / link).write_text(text)
        self._port = port
        self._told = (folder / "told.txt").open("wb")
        command = [sys.executable, "-m", "sim_heating", "live", str(folder / link), "--out", str(self.out), *options]
        if limit:
            command = ["sh", "-c", f'ulimit {limit}; exec "$0" "$@"', *command]
        with_more = os.environ | (environment or {})
        self.process = subprocess.Popen(
            command, stdout=self._told, stderr=self._told, env=with_more, preexec_fn=take_signals
        )

    def connected(self) -> socket.socket | None:
        """A connection to its source, once it listens; None where it has ended."""
        while self.process.poll() is None:
            with contextlib.suppress(OSError):
                return socket.create_connection(("127.0.0.1", self._port), 5.0)
            time.sleep(0.02)
        return None

    def ended(self, number: int | None = None) -> tuple[int, str]:
        """Send a signal, if one is given, and wait; exit status and what was reported."""
        if number is not None and self.process.poll() is None:
            self.process.send_signal(number)
        status = self.process.wait(300.0)
        self._told.close()
        return status, Path(self._told.name).read_text()

    def holds(self, count: int, wait_s: float = 60.0) -> bool:
        """Wait until its journal holds a number of messages."""
        until = time.monotonic() + wait_s
        while time.monotonic() < until:
            with contextlib.suppress(InputError):
                if sum(1 for _ in read_journal(self.out)) >= count:
                    return True
            time.sleep(0.05)
        return False


def message(number: int) -> bytes:
    """A message of a flight of constant conditions: its reading is 900 K and a tenth of a kelvin a message."""
    return json.dumps({"time_s": round(EVERY_S * number, 6), **FRAME, "tc": reading_K(number)}).encode()


def reading_K(number: int) -> float:
    """Reading of a message [K]."""
    return round(900.0 + 0.1 * (number % 100), 3)


def wrong_units(records: Path) -> int:
    """Readings of a record that were not sent."""
    record = load_record(records / POINT)
    (column,) = [c for n, c in record.thermocouples.items() if n != "time_s"]
    numbers = np.round(record.time_s / EVERY_S).astype(int).tolist()
    sent = np.array([reading_K(n) for n in numbers])
    return int(np.sum(np.abs(column - sent) > 1e-3))


def free_port() -> int:
    with socket.socket() as own:
        own.bind(("127.0.0.1", 0))
        return int(own.getsockname()[1])


# Killed and resumed --------------------------------------------------------------------------------------------------

OTHER_LINKS = ('unit = "degF"', 'unit = "degC"', "calibration = [0.0, 2.0]", 'time = "t2"')
"""Another link file: the same bodies would be other temperatures, or of other times."""


def killed(kills: int, progress: Progress, seed: int = SEED) -> dict[str, int]:
    """A link that is killed at random moments and started again, each tenth time with another link file first.

    returns : kills; messages; those of the journal at a kill that are not in the final one; those in it that were not
              sent; links of other units that were not refused in one line, or changed the journal; tracebacks; readings
              of the record that were not sent
    """
    rng = np.random.default_rng((seed, kills))
    tally = dict.fromkeys(("kills", "messages", "lost", "never sent", "not refused", "tracebacks", "wrong units"), 0)
    sent, before = 0, list[bytes]()
    with TemporaryDirectory() as folder:
        place, port = Path(folder), free_port()
        for k in range(kills + 1):
            if k % 10 == 1:
                tally["not refused"] += _not_refused(place, port, OTHER_LINKS[k // 10 % len(OTHER_LINKS)])
            running = Running(place, port)
            with running.connected() or contextlib.nullcontext() as source:
                first, count = sent, int(rng.integers(5, 60))
                for _ in range(count):
                    if source is not None:
                        source.sendall(message(sent) + b"\n")
                    sent += 1
                if k == kills or rng.random() < 0.5:
                    running.holds(len(before) + count)
                else:
                    time.sleep(float(rng.uniform(0.0, 0.05)))
                _, told = running.ended(signal.SIGINT if k == kills else signal.SIGKILL)
            now = [entry.body for entry in read_journal(running.out)]
            tally["kills"] += k < kills
            tally["lost"] += now[: len(before)] != before
            fresh = [message(n) for n in range(first, sent)]
            tally["never sent"] += now[len(before) :] != fresh[: len(now) - len(before)]
            tally["tracebacks"] += "Traceback" in told
            before = now
            if k % 10 == 0:
                progress(f"killed and started again: {k} of {kills}")
        tally["messages"] = len(before)
        tally["wrong units"] = wrong_units(running.out / "records")
    return tally


def _not_refused(place: Path, port: int, sensor: str) -> int:
    """Whether another link file is not refused in one line that names what differs, or touches the journal."""
    before = (place / "out" / NAME).read_bytes()
    status, told = Running(place, port, "other.toml", sensor).ended()
    names = "was begun with another link: `sensor 1." in told.replace("\n", " ")
    return int(status != 2 or not names or (place / "out" / NAME).read_bytes() != before)


# Hostile packets -----------------------------------------------------------------------------------------------------


def hostile(number: int, rng: np.random.Generator) -> bytes:
    """A line that is no message of the flight."""
    body = message(number)
    kind = int(rng.integers(0, 12))
    noise = rng.integers(0, 256, int(rng.integers(1, 300)), np.uint8).tobytes().replace(b"\n", b"")
    inner = BODY.pack(int(rng.integers(0, 2**62)), int(rng.integers(0, 4))) + body
    return (
        b"x" + noise,
        body[: int(rng.integers(1, len(body) - 1))],
        b"[" * int(rng.integers(1, 20_000)),
        b'{"a":' * int(rng.integers(1, 5000)),
        b'{"time_s":1e999,"tc":900}',
        b'{"time_s":NaN,"tc":-Infinity}',
        json.dumps({"time_s": "now", "tc": 900.0}).encode(),
        json.dumps({f"f{k}": k for k in range(int(rng.integers(1, 3000)))}).encode(),
        b'{"time_s":' + b"9" * int(rng.integers(20, 6000)) + b"}",
        json.dumps({"time_s": None, "tc": [[[900.0]]]}).encode(),
        b"\xff\xfe" + body[:40] + b"\x00" * int(rng.integers(1, 50)),
        (HEAD.pack(len(inner), 0) + inner).replace(b"\n", b""),  # what looks like an entry of a journal
    )[kind]


def hostile_packets(packets: int, progress: Progress, seed: int = SEED) -> dict[str, int]:
    """A flight with hostile lines between its messages, over several connections.

    returns : hostile packets; lines that came and are not in the journal; those in it that were not sent; frames of the
              flight that were not followed; tracebacks; readings of the record that were not sent; exit status
    """
    rng = np.random.default_rng((seed, packets))
    good = max(packets // 20, 50)
    with TemporaryDirectory() as folder:
        place, port = Path(folder), free_port()
        running = Running(place, port)
        source, other = running.connected(), running.connected()
        assert source is not None
        assert other is not None
        sent, hostiles = list[bytes](), 0
        for k in range(good):
            lines = [message(k), *(hostile(k, rng) for _ in range(min(20, packets - hostiles)))]
            hostiles += len(lines) - 1
            source.sendall(b"".join(line + b"\n" for line in lines))
            sent += [line for line in lines if line.strip()]
            if k % 200 == 199:
                progress(f"{hostiles} hostile packets")
        other.sendall(b"\x00" * 1000)
        other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        other.close()
        running.holds(len(sent), max(120.0, packets / 30.0))
        time.sleep(0.5)
        status, told = running.ended(signal.SIGINT)
        source.close()
        found = [entry.body for entry in read_journal(running.out)]
        counts = json.loads((running.out / "live.json").read_text())["counts"] if status == 0 else {}
        return {
            "packets": hostiles,
            "lost": missing(sent, found),
            "never sent": sum(body not in set(sent) for body in found if body != b"\x00" * len(body)),
            "not followed": good - int(counts.get("frames", 0)),
            "tracebacks": int("Traceback" in told),
            "wrong units": wrong_units(running.out / "records") if status == 0 else good,
            "status": status,
        }


# Exhausted -----------------------------------------------------------------------------------------------------------


def half_open(connections: int, descriptors: int) -> dict[str, int]:
    """A flight whose page is given connections that send nothing, in a process of few file descriptors.

    returns : messages; those that are not in the journal; tracebacks; bytes on standard output and error; exit status
    """
    with TemporaryDirectory() as folder, contextlib.ExitStack() as held:
        place, port, page = Path(folder), free_port(), free_port()
        running = Running(place, port, options=["--port", str(page)], limit=f"-n {descriptors}")
        source = running.connected()
        assert source is not None
        sent = list[bytes]()
        for k in range(connections):
            half = held.enter_context(socket.socket())
            half.setblocking(False)
            half.connect_ex(("127.0.0.1", page))
            sent.append(message(k))
            source.sendall(sent[-1] + b"\n")
            time.sleep(0.005)
        running.holds(len(sent))
        status, told = running.ended(signal.SIGINT)
        source.close()
        lost = missing(sent, [entry.body for entry in read_journal(running.out)])
        tracebacks = int("Traceback" in told)
        return {"messages": len(sent), "lost": lost, "tracebacks": tracebacks, "told": len(told), "status": status}


def full_disk(blocks: int = 16) -> dict[str, int]:
    """A flight whose files may have so many blocks of 512 bytes.

    returns : messages; those in the journal; those that had room and are not in it; whether it is not told what ran
              out, and how many are missing; tracebacks
    """
    with TemporaryDirectory() as folder:
        place, port = Path(folder), free_port()
        running = Running(place, port, limit=f"-f {blocks}")
        source = running.connected()
        assert source is not None
        sent = [message(k) for k in range(100)]
        source.sendall(b"".join(line + b"\n" for line in sent))
        time.sleep(3.0)
        _, told = running.ended(signal.SIGINT)
        source.close()
        found = [entry.body for entry in read_journal(running.out)]
        size = (running.out / NAME).stat().st_size
        least = size + HEAD.size + BODY.size + len(sent[min(len(found), 99)])
        says = f"File too large; the last {len(sent) - len(found)} messages are not in it" in " ".join(told.split())
        lost = int(found != sent[: len(found)]) + int(least <= 512 * blocks)
        tracebacks = int("Traceback" in told)
        return {"messages": 100, "found": len(found), "lost": lost, "untold": not says, "tracebacks": tracebacks}


# All -----------------------------------------------------------------------------------------------------------------


def run(sizes: Sizes | None = None, progress: Progress = print) -> list[Figure]:
    """Run all and save the results."""
    used = sizes or Sizes()
    figures = list(_figures(used, progress))
    save("journals", figures, {"sizes": asdict(used)})
    return figures


def _figures(sizes: Sizes, progress: Progress) -> Iterator[Figure]:
    found = damaged_journals(sizes.journals)
    progress(f"{found['journals']} damaged journals")
    note = f"{found['journals']} journals, {found['damaged']} messages damaged, {found['resumed']} gone on with"
    yield Figure("damaged journals: sound messages that were lost", found["lost"], "", 0.0, note=note)
    yield Figure("damaged journals: messages that were never sent", found["never sent"], "", 0.0)
    yield Figure("damaged journals: those of which the damage was not told", found["untold"], "", 0.0)
    yield Figure("damaged journals: messages that the next link lost", found["lost by the next link"], "", 0.0)
    yield Figure("damaged journals: those of which no copy was kept", found["no copy"], "", 0.0)
    yield Figure("damaged journals: errors other than a refusal in one line", found["errors"], "", 0.0)
    found = killed(sizes.kills, progress)
    note = f"{found['kills']} kills of one link, {found['messages']} messages"
    yield Figure("killed and started again: journals that lost a message", found["lost"], "", 0.0, note=note)
    yield Figure("killed and started again: journals with one that was never sent", found["never sent"], "", 0.0)
    yield Figure("killed and started again: other link files not refused", found["not refused"], "", 0.0)
    yield Figure("killed and started again: tracebacks", found["tracebacks"], "", 0.0)
    yield Figure("killed and started again: readings of a wrong unit", found["wrong units"], "", 0.0)
    found = hostile_packets(sizes.packets, progress)
    note = f"{found['packets']} packets, exit status {found['status']}"
    yield Figure("hostile packets: lines that were lost", found["lost"], "", 0.0, note=note)
    yield Figure("hostile packets: messages that were never sent", found["never sent"], "", 0.0)
    yield Figure("hostile packets: frames of the flight that were not followed", found["not followed"], "", 0.0)
    yield Figure("hostile packets: tracebacks", found["tracebacks"], "", 0.0)
    yield Figure("hostile packets: readings of a wrong unit", found["wrong units"], "", 0.0)
    for descriptors in (256, 1024):
        found = half_open(400, descriptors)
        how = f"400 half-open connections, {descriptors} descriptors"
        note = f"{found['messages']} messages, exit status {found['status']}, {found['told']} bytes told"
        yield Figure(f"{how}: messages that were lost", found["lost"], "", 0.0, note=note)
        yield Figure(f"{how}: tracebacks", found["tracebacks"], "", 0.0)
    found = full_disk()
    note = f"{found['found']} of {found['messages']} had room"
    yield Figure("full disk: messages that had room and were lost", found["lost"], "", 0.0, note=note)
    yield Figure("full disk: what ran out, and what is missing, not told", found["untold"], "", 0.0)
    yield Figure("full disk: tracebacks", found["tracebacks"], "", 0.0)


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--small", is_flag=True, help="sizes of a minute")
def main(small: bool) -> None:
    """Run and print."""
    click.echo(table(run(SMALL if small else None, click.echo)))


if __name__ == "__main__":
    main()
