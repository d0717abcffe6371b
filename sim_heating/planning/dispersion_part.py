"""A dispersion as a part of a study: files, tables and pictures."""

from __future__ import annotations

from pathlib import Path

from sim_heating.files import write_text_atomic
from sim_heating.page import Table
from sim_heating.planning.dispersion import (
    FLIGHTS_FILE,
    Answer,
    Dispersed,
    data_of,
    disperse,
    merge,
    notes_of,
    place_of,
)
from sim_heating.planning.dispersion_plots import draw_distributions, draw_drivers, draw_first_order
from sim_heating.planning.plan import Engine, Found, Part, Picture, program_digest
from sim_heating.planning.study import Study
from sim_heating.progress import Progress

CSV = "dispersion.csv"
PEAKS, FIRST_ORDER, DRIVERS = (f"dispersion_{what}.png" for what in ("peaks", "first_order", "drivers"))
NO_BREAK = "\N{NO-BREAK SPACE}"
LEAST_INDEX = 0.01
"""Smallest total index that the table of what drives a peak names."""


def dispersion_part(study: Study, folder: Path, engine: Engine, progress: Progress) -> Found:
    """Fly a study's dispersion and write what it tells."""
    ledger = engine.ledger / f"dispersion-{study.hash}-{program_digest()}"
    found, files = disperse(
        study,
        ledger,
        scheduler=engine.scheduler,
        workers=engine.workers,
        progress=lambda f, text: progress(0.95 * f, text),
    )
    progress(0.96, "writing")
    merge(files["main"], folder / FLIGHTS_FILE)
    _write_csv(found, folder / CSV)
    title = f"{study.title}\n{study.stamp}"
    pictures = [Picture(PEAKS, "Peak temperatures of all flights, quantiles with bounds, limits.")]
    draw_distributions(folder / PEAKS, title, found)
    pictures.append(Picture(FIRST_ORDER, "Quantiles to first order beside those counted."))
    draw_first_order(folder / FIRST_ORDER, title, found)
    if any(a.indices is not None for a in found.answers):
        pictures.append(Picture(DRIVERS, "What drives each peak: total Sobol' indices."))
        draw_drivers(folder / DRIVERS, title, found)
    return Found(data_of(found), tuple(_tables(found)), tuple(pictures), tuple(_notes(found)))


DISPERSION = Part(dispersion_part, lambda _: (FLIGHTS_FILE, CSV, PEAKS, FIRST_ORDER, DRIVERS))


def _notes(found: Dispersed) -> list[str]:
    spec, kept, safe = found.entry.spec, found.kept, found.safe
    head = (
        f"{spec.flights} flights: all limits are kept with a probability of {kept.value:.4f} ({kept.low:.4f} to "
        f"{kept.high:.4f}, {spec.confidence:.0%}), within the ratio tables and trimmed as well {safe.value:.4f}"
    )
    return [head, *notes_of(found)]


def _tables(found: Dispersed) -> list[Table]:
    spec = found.entry.spec
    heads = ("control point", "mean", "sigma", *(f"{q:g} quantile" for q in spec.quantiles), "limit", "above it")
    rows = tuple(_row(a) for a in found.answers)
    caption = f"Peak temperatures [K] of {spec.flights} flights, in brackets bounds of {spec.confidence:.0%}"
    tables = [Table(heads, rows, caption)]
    first = tuple(
        (
            f"{a.point} {place_of(a)}", f"{a.first['mean_K']:.0f}", f"{a.first['sigma_K']:.1f}", f"{a.sigma_K:.1f}",
            *("-" if q["apart_K"] is None else f"{q['apart_K']:+.1f}" for q in a.first["quantiles"]),
            "yes" if a.first["holds"] else "no",
        )
        for a in found.answers
    )  # fmt: skip
    heads = ("control point", "mean flight", "sigma", "counted", *(f"{q:g} quantile" for q in spec.quantiles), "holds")
    caption = "First order through the sensitivities along the mean flight [K]: quantiles less those counted"
    tables.append(Table(heads, first, caption))
    driven = [(f"{a.point} {place_of(a)}", _drivers(found, a)) for a in found.answers if a.indices is not None]
    if driven:
        caption = f"What drives the peaks: total Sobol' indices above {LEAST_INDEX:g}, first-order index in brackets"
        tables.append(Table(("control point", "inputs"), driven, caption, words=(1,)))
    return tables


def _row(a: Answer) -> tuple[str, ...]:
    def bounds(low: float | None, high: float | None) -> str:
        ends = ("-" if end is None else f"{end:.0f}" for end in (low, high))
        return f" ({f'{NO_BREAK}to{NO_BREAK}'.join(ends)})"

    quantiles = [("-" if q.value is None else f"{q.value:.0f}") + bounds(q.low, q.high) for q in a.quantiles]
    e = a.exceeded
    above = "-" if e is None else f"{e.value:.4f} ({e.low:.4f}{NO_BREAK}to{NO_BREAK}{e.high:.4f})"
    limit = "-" if a.limit is None else f"{a.limit:.0f}"
    return (f"{a.point} {place_of(a)}", f"{a.mean_K:.0f}", f"{a.sigma_K:.1f}", *quantiles, limit, above)


def _drivers(found: Dispersed, a: Answer) -> str:
    assert a.indices is not None  # the caller's choice
    named = sorted(
        zip(found.entry.words, a.indices.total.tolist(), a.indices.first.tolist(), strict=True), key=lambda x: -x[1]
    )
    return "; ".join(f"{what} {t:.2f} ({f:.2f})" for (what, _), t, f in named if t > LEAST_INDEX)


def _write_csv(found: Dispersed, path: Path) -> None:
    """The quantiles as a table for programs."""
    study = found.entry.study
    header = {"vehicle": study.vehicle.name, "revision": study.vehicle.revision, "study": study.hash}
    lines = ["control_point,quantity,q,value_K,low_K,high_K,scatter_K,first_order_K"]
    for a in found.answers:
        for q, first in zip(a.quantiles, a.first["quantiles"], strict=True):
            cells = [q.value, q.low, q.high, q.scatter, first["value_K"]]
            told = ",".join("" if c is None else f"{c:.3f}" for c in cells)
            lines.append(f"{a.point},peak_{place_of(a)},{q.q:g},{told}")
    head = "".join(f"# {k}: {v}\n" for k, v in header.items())
    write_text_atomic(path, head + "\n".join(lines) + "\n")
