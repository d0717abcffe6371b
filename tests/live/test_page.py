"""The page of a link in a real browser: charts move, a stalled link is seen, whatever the screen and the texts."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

from sim_heating.live.state import LinkState, RemovedSensor
from tests.support.browser import PRINTABLE_PX, hostile, needs_browser
from tests.support.chromium import Browser
from tests.support.served import served

pytestmark = needs_browser

PHASE = "document.getElementById('phase').dataset.phase"
DRAWN = "Number(document.documentElement.dataset.drawn || -1)"
PICTURES = "[...document.querySelectorAll('canvas')].map((c) => c.toDataURL())"
TEXT = "document.getElementById('{}').textContent"
SEEN_WITHIN_S = 2.0
ESTIMATE = 0xFFB27200
"""Colour of the estimate as a pixel holds it, #0072B2."""
AS_FLOWN = 0xFFAEA49A
"""That of the declared ratio as it was flown, #9aa4ae."""
KEYS = "[...document.querySelectorAll('#strips .key')]"


def wait_until(shown, expression, wanted, within_s=15.0):
    """The time after which an expression had a value that is wanted [s]."""
    start = time.monotonic()
    while not wanted(found := shown.evaluate(expression)):
        assert time.monotonic() - start < within_s, f"{expression} is {found}"
        time.sleep(0.02)
    return time.monotonic() - start


class Playing:
    """States that are published at 10 Hz in the background, until told to stop."""

    def __init__(self, served_page, states):
        self._stop = threading.Event()
        self._thread = threading.Thread(target=served_page.play, args=(self._until_stopped(states), 10.0))

    def _until_stopped(self, states):
        for state in states:
            if self._stop.is_set():
                return
            yield state

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


def test_charts_move_and_a_stalled_link_is_seen(flown):
    states = flown.states(flown.popu_s - 5.0, flown.popu_s + 60.0)
    with served(flown.display) as (server, page), Browser() as browser:
        with Playing(page, states):
            shown = browser.open(server.url)
            wait_until(shown, DRAWN, lambda n: n > 0)
            assert shown.evaluate(PHASE) == "live"
            before, first = shown.evaluate(PICTURES), shown.evaluate(DRAWN)
            assert len(before) == 7  # surface, depth, bondline, angle of attack; surface and bondline ahead; ratio
            wait_until(shown, DRAWN, lambda n: n > first + 5)
            assert [a != b for a, b in zip(before[:4], shown.evaluate(PICTURES)[:4], strict=True)] == [True] * 4
        stopped = time.monotonic()
        wait_until(shown, PHASE, lambda phase: phase == "stalled")
        assert time.monotonic() - stopped <= SEEN_WITHIN_S
        assert "stale" in shown.evaluate("document.body.className")
        with Playing(page, states):
            wait_until(shown, PHASE, lambda phase: phase == "live", SEEN_WITHIN_S)
            _choose_another_point(shown)
            _fit_every_screen(shown)
        _told_by_the_link_itself(page, next(states), shown)
        page.publish(replace(next(states), sequence=10_000))
        wait_until(shown, PHASE, lambda phase: phase == "live")
        assert shown.complaints() == []
        stopped = time.monotonic()
        page.loop.run(server.stop())
        wait_until(shown, PHASE, lambda phase: phase == "disconnected")
        assert time.monotonic() - stopped <= SEEN_WITHIN_S + 1.0  # the server takes leave for up to a second


def _choose_another_point(shown):
    """Strip charts, look-ahead and ratio follow the reader."""
    assert shown.evaluate(TEXT.format("shown")) == "LS"
    shown.evaluate("[...document.querySelectorAll('#points button')].find((b) => b.textContent === 'OE').click()")
    wait_until(shown, TEXT.format("shown"), lambda name: name == "OE")
    wait_until(shown, TEXT.format("sensors"), lambda text: "OE_surface" in text)
    wait_until(shown, "document.querySelectorAll('canvas').length", lambda n: n == 6)  # it has no sensor in depth
    assert shown.evaluate(TEXT.format("ahead-of")) == "Ahead of OE"


def _fit_every_screen(shown):
    """From a phone to a control room nothing is wider than the screen."""
    for width in (390, 768, 1400, 1920):
        shown.resize(width, 900)
        first = shown.evaluate(DRAWN)
        wait_until(shown, DRAWN, lambda n, first=first: n > first + 2)
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        widest = "Math.max(...[...document.querySelectorAll('.uplot')].map((u) => u.getBoundingClientRect().right))"
        assert shown.evaluate(widest) <= width


def _told_by_the_link_itself(page, state, shown):
    """A link that has ended is ended, not stalled, though nothing comes any more."""
    for phase in ("stalled", "waiting", "ended"):
        page.publish(replace(state, sequence=state.sequence + 1, link=LinkState(phase, 3.0)))
        state = replace(state, sequence=state.sequence + 1)
        wait_until(shown, PHASE, lambda found, phase=phase: found == phase, SEEN_WITHIN_S)
    time.sleep(SEEN_WITHIN_S)
    assert shown.evaluate(PHASE) == "ended"


def test_a_page_that_is_opened_late_shows_what_came_before(flown):
    states = list(flown.states(flown.popu_s - 5.0, flown.popu_s + 20.0))
    with served(flown.display) as (server, page), Browser() as browser:
        for state in states:
            page.publish(state)
        shown = browser.open(server.url)
        wait_until(shown, DRAWN, lambda n: n == len(states) - 1)
        shown.evaluate("document.getElementById('ratio').scrollIntoView()")
        assert "off the declared one" in shown.evaluate(TEXT.format("ratio-text"))
        pixels = (
            "(c => c.getContext('2d').getImageData(0, 0, c.width, c.height))(document.querySelector('#ratio canvas'))"
        )
        dots = f"new Uint32Array({pixels}.data.buffer).filter((p) => p === {{}}).length"
        assert shown.complaints() == []
        for color in (ESTIMATE, AS_FLOWN):  # over all the angles that were flown
            wait_until(shown, dots.format(color), lambda n: n > 100)
        assert "stuck for 12 s" in shown.evaluate(TEXT.format("removed")) + shown.evaluate(TEXT.format("sensors"))


def test_keys_of_strip_charts_show_the_latest_values_without_a_cursor(flown):
    *_, state = flown.states(flown.popu_s, flown.popu_s + 2.0)
    with served(flown.display) as (server, page), Browser() as browser:
        page.publish(state)
        shown = browser.open(server.url)
        wait_until(shown, DRAWN, lambda n: n >= 0)
        wait_until(shown, f"{KEYS}.at(-1).textContent", lambda text: text == f"{state.conditions['alpha_deg']:.2f}")
        keys = dict(shown.evaluate(f"{KEYS}.map((k) => [k.children[0].textContent, k.children[1].textContent])"))
        point = state.points["LS"]
        assert keys["surface"] == f"{point.surface_K:.1f}"
        assert keys["LS_surface measured"] == f"{point.sensors['LS_surface'].measured_K:.1f}"
        assert keys["limit 1533 K"] == ""  # it says it by its name


def test_on_paper_all_charts_are_drawn_and_nothing_is_wider(flown):
    """Also those that are not on the screen, which are not drawn there."""
    with served(flown.display) as (server, page), Browser() as browser:
        for state in flown.states(flown.popu_s, flown.popu_s + 5.0):
            page.publish(state)
        shown = browser.open(server.url, 390, 700)
        wait_until(shown, DRAWN, lambda n: n >= 49)
        drawn = "(() => { const c = document.querySelector('#ratio canvas'); return c ? c.toDataURL() : ''; })()"
        before = shown.evaluate(drawn)
        shown.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        wait_until(shown, drawn, lambda picture: picture != before)
        shown.resize(PRINTABLE_PX)
        shown.call("Emulation.setEmulatedMedia", media="print")
        assert shown.evaluate("[...document.querySelectorAll('.chart canvas')].every((c) => c.offsetParent)")
        assert shown.evaluate("document.documentElement.scrollWidth") <= PRINTABLE_PX
        assert shown.complaints() == []


def test_texts_of_a_link_are_shown_as_texts(flown):
    """Names and reasons come from telemetry, too."""
    *_, state = flown.states(flown.popu_s, flown.popu_s + 1.0)
    bad = hostile("why")
    state = replace(
        state,
        removed=[RemovedSensor(bad, bad, 1.0, bad)],
        link=replace(state.link, messages=[bad]),
        missing=replace(state.missing, text=bad),
    )
    with served(replace(flown.display, title=bad)) as (server, page), Browser() as browser:
        page.publish(state)
        shown = browser.open(server.url)
        wait_until(shown, DRAWN, lambda n: n >= 0)
        assert shown.evaluate("document.documentElement.dataset.ran") is None
        assert shown.evaluate("document.querySelectorAll('#messages *').length") == 1
        assert shown.complaints() == []
