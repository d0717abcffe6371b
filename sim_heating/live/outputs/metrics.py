"""Metrics of a link for Prometheus: the latest state as gauges, counts of the link as counters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from sim_heating.live.outputs.published import Published
from sim_heating.live.state import State

if TYPE_CHECKING:
    from prometheus_client.core import Metric

POINT = {
    "surface_kelvin": ("surface_K", "temperature of the outer surface"),
    "surface_sigma_kelvin": ("surface_sigma_K", "standard deviation of the surface temperature"),
    "bondline_kelvin": ("bondline_K", "temperature of the bondline"),
    "bondline_sigma_kelvin": ("bondline_sigma_K", "standard deviation of the bondline temperature"),
    "heating_ratio": ("ratio", "estimated heating ratio"),
    "heating_ratio_sigma": ("ratio_sigma", "standard deviation of the heating ratio"),
    "heating_ratio_declared": ("ratio_declared", "heating ratio of the declared model"),
    "margin_kelvin": ("margin_K", "least present distance to a limit"),
    "knock_off_by_seconds": ("knock_off_by_s", "flight time until which stopping the manoeuvre keeps the limits"),
}
"""Gauges of a control point: name, field of its state, and what it is."""
SENSOR = {
    "sensor_measured_kelvin": ("measured_K", "latest reading"),
    "sensor_predicted_kelvin": ("predicted_K", "predicted reading"),
    "sensor_sigma_kelvin": ("sigma_K", "standard deviation of the predicted reading"),
    "sensor_used": ("used", "whether the sensor updates the estimate"),
}
FUTURE = {
    "ahead_peak_surface_kelvin": ("peak_surface_K", "highest surface temperature ahead"),
    "ahead_margin_kelvin": ("margin_K", "least distance to a limit ahead"),
    "ahead_limit_probability": ("probability", "probability that a limit is passed"),
}
LINK = {
    "link_since_seconds": ("since_s", "time since the last message"),
    "link_frames_hertz": ("frames_Hz", "frames of conditions a second"),
    "link_readings_hertz": ("readings_Hz", "readings a second"),
    "link_lateness_seconds": ("lateness_s", "largest lateness of a sample that was still used"),
}
COUNTS = {
    "link_late": "samples put where they belong",
    "link_too_late": "samples too late to be used",
    "link_doubled": "doubled samples",
    "link_damaged": "messages that could not be read",
    "link_lost": "lost words",
    "link_jumps": "jumps of the clock",
}
PHASES = ("waiting", "live", "stalled", "ended")
PREFIX = "sim_heating_"


class Metrics:
    """The latest state of a link as Prometheus reads it."""

    def __init__(self) -> None:
        self._state: State | None = None

    def publish(self, published: Published) -> None:
        """Keep a state until it is asked for."""
        self._state = published.state

    @property
    def content_type(self) -> str:
        """Media type of `text`."""
        from prometheus_client import CONTENT_TYPE_LATEST

        return CONTENT_TYPE_LATEST

    def text(self) -> bytes:
        """All metrics in the text format of Prometheus; none before the first state."""
        from prometheus_client import CollectorRegistry, generate_latest

        registry = CollectorRegistry()
        registry.register(self)  # type: ignore[arg-type]  # what it needs of a collector is `collect`
        return generate_latest(registry)

    def collect(self) -> Iterator[Metric]:
        """Metrics of the latest state; one that is not known is absent."""
        if self._state is not None:
            yield from _of_link(self._state)
            yield from _of_points(self._state)


def _of_link(state: State) -> Iterator[Metric]:
    from prometheus_client.core import CounterMetricFamily

    yield _gauge("flight_time_seconds", "flight time of the estimate", {(): state.time_s})
    yield from _gauges(LINK, {(): state.link})
    phases = {(phase,): phase == state.link.state for phase in PHASES}
    yield _gauge("link_state", "1 for the state that the link is in", phases, "state")
    for name, text in COUNTS.items():
        counter = CounterMetricFamily(PREFIX + name, text)
        counter.add_metric((), float(getattr(state.link, name.removeprefix("link_"))))
        yield counter


def _of_points(state: State) -> Iterator[Metric]:
    """Metrics of control points, their sensors, parameters and futures, and of what they lack."""
    yield from _gauges(POINT, {(name,): point for name, point in state.points.items()}, "point")
    sensors = {(p, s): sensor for p, point in state.points.items() for s, sensor in point.sensors.items()}
    yield from _gauges(SENSOR, sensors, "point", "sensor")
    parameters = {
        (p, name, parameter.unit): parameter
        for p, point in state.points.items()
        for name, parameter in point.parameters.items()
    }
    about = {"parameter": ("value", "estimated parameter"), "parameter_sigma": ("sigma", "standard deviation of it")}
    yield from _gauges(about, parameters, "point", "parameter", "unit")
    futures = {(p, name): future for p, point in state.points.items() for name, future in point.ahead.items()}
    yield from _gauges(FUTURE, futures, "point", "future")
    removed = {(removal.point, removal.sensor): removal.since_s for removal in state.removed}
    yield _gauge("sensor_removed_since_seconds", "flight time since when it is out", removed, "point", "sensor")
    missing = state.missing
    yield _gauge("missing_effect_alarm", "whether the test for a missing effect has fired", {(): missing.alarm})
    yield _gauge("missing_effect_statistic", "statistic of the test for a missing effect", {(): missing.statistic})
    yield _gauge("missing_effect_threshold", "where the test for a missing effect fires", {(): missing.threshold})
    candidates = {(candidate.what,): candidate.probability for candidate in missing.candidates}
    yield _gauge("missing_effect_probability", "what could be missing", candidates, "effect")


def _gauges(
    descriptions: Mapping[str, tuple[str, str]], owners: Mapping[Any, object], *labels: str
) -> Iterator[Metric]:
    for name, (field, text) in descriptions.items():
        yield _gauge(name, text, {key: getattr(owner, field) for key, owner in owners.items()}, *labels)


def _gauge(name: str, text: str, values: Mapping[Any, float | None], *labels: str) -> Metric:
    from prometheus_client.core import GaugeMetricFamily

    gauge = GaugeMetricFamily(PREFIX + name, text, labels=labels)
    for key, value in values.items():
        if value is not None:
            gauge.add_metric(key, float(value))
    return gauge
