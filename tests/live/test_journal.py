"""The journal keeps what came through kills, cut-off files and full disks, and goes on where it ended."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path

import pytest

from benchmarks.journals import damaged_journals
from sim_heating.base.errors import InputError
from sim_heating.live.recording import journal as journal_module
from sim_heating.live.recording.journal import BODY, HEAD, NAME, Journal, damage_of, read_head, read_journal
from sim_heating.live.types import LONGEST_BODY

LINK = {"format": "link/1", "vehicle": "orbiter"}
PLACE = Path("scenarios/live/test.toml")


def journal(folder: Path, **options: float) -> Journal:
    return Journal(folder / NAME, LINK, PLACE, **options)


def written(folder: Path, sent: list[bytes], *, is_end: bool = True) -> Path:
    own = journal(folder)
    for body in sent:
        own.append(body)
    own.close(is_end=is_end)
    return folder / NAME


def flip(file: Path, body: bytes) -> None:
    """Flip a bit of a body."""
    data = bytearray(file.read_bytes())
    data[data.index(body)] ^= 1
    file.write_bytes(data)


def bodies(folder: Path) -> list[bytes]:
    return [entry.body for entry in read_journal(folder)]


def test_a_journal_holds_every_body_in_order(tmp_path):
    own = journal(tmp_path)
    sent = [b"", b"\n", bytes(range(256)), *(f"message {k}".encode() for k in range(500))]
    for k, body in enumerate(sent):
        own.append(body, source=k % 3)
    own.close(is_end=True)
    assert bodies(tmp_path) == sent
    assert [e.source for e in read_journal(tmp_path)][:4] == [0, 1, 2, 0]
    head = read_head(tmp_path)
    assert (head.link, head.entries, head.is_closed) == (LINK, len(sent), True)
    assert head.size < (tmp_path / NAME).stat().st_size + 1


@pytest.mark.parametrize("cut", [1, 7, 20])
def test_a_journal_that_was_cut_off_goes_on_behind_its_last_whole_message(tmp_path, cut):
    own = journal(tmp_path)
    for k in range(10):
        own.append(b"message %d" % k)
    own.close(is_end=False)
    file = tmp_path / NAME
    file.write_bytes(file.read_bytes()[:-cut])
    assert len(bodies(tmp_path)) == 9
    again = journal(tmp_path)
    assert again.is_resumed
    again.append(b"after")
    again.close(is_end=True)
    assert bodies(tmp_path) == [*(b"message %d" % k for k in range(9)), b"after"]


def test_a_bit_that_flipped_costs_one_message_which_is_told(tmp_path):
    file = written(tmp_path, [b"message %d" % k for k in range(10)])
    flip(file, b"message 5")
    assert bodies(tmp_path) == [b"message %d" % k for k in range(10) if k != 5]
    head = read_head(tmp_path)
    assert head.is_closed
    (told,) = damage_of(tmp_path)
    assert f"1 message of 27 bytes from byte {head.skipped[0].begin} on, behind message 5, are damaged" in told


def test_a_length_that_leads_to_a_later_message_loses_none_between(tmp_path):
    """All messages of one size: a changed length ends where another message does."""
    file = written(tmp_path, [b"message %d" % k for k in range(10)])
    data, size = bytearray(file.read_bytes()), HEAD.size + BODY.size + len(b"message 0")
    begin = data.index(b"message 2") - HEAD.size - BODY.size
    data[begin : begin + 4] = (size - HEAD.size + 3 * size).to_bytes(4, "little")
    file.write_bytes(data)
    assert bodies(tmp_path) == [b"message %d" % k for k in range(10) if k != 2]


def test_a_damaged_journal_is_kept_aside_and_gone_on_with(tmp_path):
    file = written(tmp_path, [b"message %d" % k for k in range(10)], is_end=False)
    flip(file, b"message 5")
    damaged = file.read_bytes()
    again = journal(tmp_path)
    assert "behind message 5" in again.notes[0]
    assert "the damaged journal is kept as" in again.notes[1]
    again.append(b"after")
    again.close(is_end=True)
    assert bodies(tmp_path) == [*(b"message %d" % k for k in range(10) if k != 5), b"after"]
    assert damage_of(tmp_path) == []
    assert (tmp_path / "journal.damaged-1.bin").read_bytes() == damaged


@pytest.mark.parametrize("cut", [1, 300])
def test_a_header_that_is_damaged_is_read_from_its_copy(tmp_path, cut):
    file = written(tmp_path, [b"message"] * 3, is_end=False)
    data = bytearray(file.read_bytes())
    begin = data.index(b"\n")
    data[begin - min(cut, begin - 1) : begin] = bytes(min(cut, begin - 1))
    file.write_bytes(data)
    assert read_head(tmp_path).link == LINK
    assert bodies(tmp_path) == [b"message"] * 3
    again = journal(tmp_path)
    assert again.is_resumed
    assert "a copy of the header is used" in again.notes[0]
    again.close(is_end=False)


def test_messages_without_a_header_are_read_but_not_continued(tmp_path):
    file = written(tmp_path, [b"message %d" % k for k in range(10)], is_end=False)
    data = file.read_bytes()
    begin = data.index(b"message 0") - HEAD.size - BODY.size
    file.write_bytes(bytes(begin) + data[begin:])
    assert len(bodies(tmp_path)) == 10
    with pytest.raises(InputError, match="make a record of them with --to-record, and name the LINK that wrote it"):
        journal(tmp_path)
    assert len(bodies(tmp_path)) == 10


def test_a_body_that_could_not_be_read_back_is_refused(tmp_path):
    own, longest = journal(tmp_path), bytes(LONGEST_BODY)
    own.append(longest)
    with pytest.raises(InputError, match=r"a message of 16\.0 MiB; one of more than 16 MiB is refused"):
        own.append(longest + b"x")
    own.append(b"after")
    own.close(is_end=True)
    assert [len(body) for body in bodies(tmp_path)] == [len(longest), 5]


def test_a_body_of_an_earlier_version_that_was_longer_is_read(tmp_path):
    file = written(tmp_path, [b"before"], is_end=False)
    content = BODY.pack(1, 0) + bytes(LONGEST_BODY + 1000)
    with file.open("ab") as stream:
        stream.write(HEAD.pack(len(content), zlib.crc32(content)) + content)
    assert [len(body) for body in bodies(tmp_path)] == [6, LONGEST_BODY + 1000]


@pytest.mark.thorough
def test_damaged_journals_of_all_kinds_lose_what_was_damaged_alone():
    """A sample of `python -m benchmarks journals`."""
    found = damaged_journals(60, seed=1)
    assert found["damaged"] > 0
    assert found["resumed"] > 10
    assert {k: v for k, v in found.items() if k not in ("journals", "damaged", "resumed")} == dict.fromkeys(
        ("lost", "never sent", "untold", "lost by the next link", "no copy", "errors"), 0
    )


def test_a_link_that_was_not_begun_leaves_no_journal(tmp_path):
    journal(tmp_path).close(is_end=False)
    assert not (tmp_path / NAME).exists()


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of files that are open in the moment of an interrupt
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_while_a_journal_is_made_leaves_nothing(tmp_path):
    """At each line of its module that is run for it."""
    for number in range(1000):
        lines = iter(range(number))

        def interrupt(frame, event, _, lines=lines):
            if frame.f_code.co_filename != journal_module.__file__:
                return None
            if event == "line" and next(lines, None) is None:
                raise KeyboardInterrupt
            return interrupt

        before = sys.gettrace()
        sys.settrace(interrupt)
        try:
            begun = journal(tmp_path / "out")
        except KeyboardInterrupt:
            assert list(tmp_path.iterdir()) == [], f"line {number}"
        else:
            break
        finally:
            sys.settrace(before)
    begun.close(is_end=False)
    assert number > 50


def test_a_journal_is_gone_on_with_by_the_same_link_alone(tmp_path):
    source = {"kind": "json-lines", "port": 5500}
    begun = {**LINK, "source": [source], "sensor": [{"sensor": "A", "field": "tc", "unit": "degF"}]}
    own = Journal(tmp_path / NAME, begun, PLACE)
    own.append(b"message")
    own.close(is_end=False)
    kelvin = {**begun, "sensor": [{"sensor": "A", "field": "tc"}]}
    two = {**begun, "source": [source, source]}
    for other, told in (
        (kelvin, '`sensor 1.unit` was "degF", now "K"'),
        (two, r"\[\[source\]\]: there were 1, now 2"),
        ({**begun, "time": {"unit": "ms"}}, '`time.unit` was "s", now "ms"'),
        ({**begun, "conditions": {"altitude_m": {"field": "h", "unit": "ft"}}}, "`conditions.altitude_m` was absent"),
        ({**begun, "source": [{**source, "kind": "jsbsim"}]}, '`source 1.kind` was "json-lines", now "jsbsim"'),
    ):
        with pytest.raises(InputError, match=told):
            Journal(tmp_path / NAME, other, PLACE)
    same = {**begun, "source": [{**source, "port": 5501}], "title": "evening", "estimate": {"wander": 0.1}}
    again = Journal(tmp_path / NAME, same, PLACE)
    assert again.is_resumed
    again.close(is_end=False)


def test_a_vehicle_whose_columns_were_changed_is_another_link(tmp_path):
    means = {"columns": ["altitude_m"], "sensors": {"P": {"A": {"column": "A_K", "bits": 8}}}, "files": {}}
    own = Journal(tmp_path / NAME, LINK, PLACE, means=means)
    own.append(b"message")
    own.close(is_end=False)
    changed = {**means, "sensors": {"P": {"A": {"column": "A_K", "bits": 10}}}}
    with pytest.raises(InputError, match=r"`sensors\.P\.A\.bits` was 8, now 10"):
        Journal(tmp_path / NAME, LINK, PLACE, means=changed)


def test_a_journal_of_an_earlier_version_is_gone_on_with_and_says_so(tmp_path):
    header = {"format": "live-journal/1", "started": "2026-01-01T00:00:00Z", "path": "/l.toml", "link": LINK}
    content = BODY.pack(1, 0) + b"message"
    entry = HEAD.pack(len(content), zlib.crc32(content)) + content
    (tmp_path / NAME).write_bytes(json.dumps(header).encode() + b"\n" + entry)
    own = Journal(tmp_path / NAME, LINK, PLACE, means={"columns": []})
    assert "is of an earlier version" in own.notes[0]
    own.append(b"after")
    own.close(is_end=True)
    assert bodies(tmp_path) == [b"message", b"after"]


def test_ended_flight_is_not_written_to_and_links_share_no_journal(tmp_path):
    own = journal(tmp_path)
    with pytest.raises(InputError, match="another link writes it"):
        journal(tmp_path)
    own.close(is_end=True)
    with pytest.raises(InputError, match="holds a flight that has ended; make a record of it with --to-record"):
        journal(tmp_path)


def test_what_is_no_journal_is_one_line(tmp_path):
    (tmp_path / NAME).write_text("time_s,altitude_m\n")
    for place in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError) as told:
            read_head(place)
        assert len(told.value.problems) == 1


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_link_that_is_killed_has_lost_nothing_that_it_took(tmp_path):
    code = (
        "import sys\nfrom pathlib import Path\nfrom tests.live.test_journal import journal\n"
        f"own = journal(Path({str(tmp_path)!r}), fsync_s=1.0)\nk = 0\n"
        "while True:\n    own.append(b'message %d' % k)\n    k += 1\n    print(k, flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    time.sleep(0.2)
    told = [process.stdout.readline() for _ in range(200)]
    process.send_signal(signal.SIGKILL)
    rest = process.stdout.read().splitlines()
    process.stdout.close()
    process.wait()
    taken = int(next(line for line in reversed([*told, *rest]) if line.strip().isdigit()))
    found = bodies(tmp_path)
    assert found == [b"message %d" % k for k in range(len(found))]
    assert len(found) in (taken, taken + 1)


@pytest.mark.skipif(os.name != "posix", reason="a limit on the size of files")
def test_messages_wait_for_a_full_disk_and_are_written_in_order(tmp_path, monkeypatch):
    import resource

    monkeypatch.setattr("sim_heating.live.recording.journal.RETRY_S", 0.0)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    own = journal(tmp_path)
    try:
        for k in range(5):
            own.append(b"x" * 100 + b"%d" % k)
        size = (tmp_path / NAME).stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 150, hard))  # room for one more and a part of the next
        for k in range(5, 9):
            own.append(b"x" * 100 + b"%d" % k)
        assert "messages wait in memory" in own.problem
        assert len(bodies(tmp_path)) == 6  # no part of a message is left behind
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        own.append(b"x" * 100 + b"9")
        assert own.problem == ""
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
        own.close(is_end=True)
    assert bodies(tmp_path) == [b"x" * 100 + b"%d" % k for k in range(10)]
    assert own.dropped == 0


@pytest.mark.skipif(os.name != "posix", reason="a limit on the size of files")
def test_full_disk_leaves_a_journal_up_to_the_last_message_that_fits(tmp_path):
    import resource

    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    own = journal(tmp_path)
    own.append(b"message 0")
    size, each = (tmp_path / NAME).stat().st_size, HEAD.size + BODY.size + len(b"message 0")
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 4 * each + each // 2, hard))
        for k in range(1, 9):
            own.append(b"message %d" % k)
        own.close(is_end=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert bodies(tmp_path) == [b"message %d" % k for k in range(5)]
    assert own.problem.endswith("File too large; the last 4 messages are not in it")
    assert damage_of(tmp_path) == []


@pytest.mark.skipif(os.name != "posix" or sys.platform == "darwin", reason="a limit on file descriptors, in /proc")
def test_journal_is_written_without_a_free_descriptor(tmp_path):
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    own = journal(tmp_path)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 1, hard))
        taken = []
        with contextlib.suppress(OSError):  # until there are too many open files
            while True:
                taken.append(os.dup(1))
        with pytest.raises(OSError, match="Too many open files"):
            os.dup(1)
        for k in range(100):
            own.append(b"message %d" % k)
        assert own.problem == ""
        own.close(is_end=True)
        (tmp_path / "results").write_text("written with what the journal kept")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for number in taken:
            os.close(number)
    assert len(bodies(tmp_path)) == 100
    assert read_head(tmp_path).is_closed


def test_a_journal_leaves_no_lock(tmp_path):
    own = journal(tmp_path)
    own.append(b"message")
    own.close(is_end=True)
    assert [p.name for p in tmp_path.iterdir()] == [NAME]
