"""The journal keeps what came through kills, cut-off files and full disks, and goes on where it ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.live.recording.journal import NAME, Journal, read_head, read_journal

LINK = {"format": "link/1", "vehicle": "orbiter"}
PLACE = Path("scenarios/live/test.toml")


def journal(folder: Path, **options: float) -> Journal:
    return Journal(folder / NAME, LINK, PLACE, **options)


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


def test_a_bit_that_flipped_ends_what_can_be_read(tmp_path):
    own = journal(tmp_path)
    for k in range(10):
        own.append(b"message %d" % k)
    own.close(is_end=True)
    data = bytearray((tmp_path / NAME).read_bytes())
    data[data.index(b"message 5")] ^= 1
    (tmp_path / NAME).write_bytes(data)
    assert bodies(tmp_path) == [b"message %d" % k for k in range(5)]
    assert not read_head(tmp_path).is_closed


def test_a_flight_that_has_ended_is_not_written_to_and_two_links_share_no_journal(tmp_path):
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
def test_messages_wait_while_the_disk_is_full_and_are_written_in_order_afterwards(tmp_path, monkeypatch):
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
