"""Conduction against exact solutions and published benchmarks, on meshes and at steps that resolve the heating."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc

from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import PressureTable
from tests.support.verification import exact
from tests.support.verification.row import Row, within
from tests.support.walls import FloatArray, even_mesh, flight, from_the_first_instant, heat, material, wall

K, A, RHO_C = 1.0, 1e-6, 1e6
"""Conductivity [W/(m K)], diffusivity [m2/s] and heat capacity [J/(m3 K)] of the default material."""
START_K, Q_W_M2 = 300.0, 1e4
DEEP_M, SENSOR_M = 0.12, 0.005
"""A wall twelve diffusion lengths thick in 100 s is a half space; a depth of half a diffusion length."""
CP_J_KGK = 1004.5
STIFF_W_M2K = 1e7
"""Film coefficient that holds a face at the temperature of its gas."""
RATIO_ONE = {"ratio.d0": 1.0}
NODES = 200
MESH_SHARE = 1e-4
MESH = "second-order error of 200 nodes, 1e-4 of the rise"
CARSLAW = "Carslaw & Jaeger (1959)"


def film(h_W_m2K: float, T_gas_K: FloatArray | float) -> dict[str, FloatArray | float]:
    """Columns of a film of constant coefficient [W/(m2 K)] to gas at a temperature [K]; cp is CP_J_KGK."""
    return {"h_ref_kg_m2_s": h_W_m2K / CP_J_KGK, "H_r_J_kg": CP_J_KGK * T_gas_K}


def of_rise(
    reference: str, expected: float, got: float, source: str, share: float = MESH_SHARE, is_: str = MESH
) -> Row:
    """A temperature whose limit is a share of its rise over the start, at least 1 mK."""
    return Row(reference, expected, got, max(share * abs(expected - START_K), 1e-3), "K", source, is_)


def half_space_flux() -> list[Row]:
    """Half space under a constant flux: surface and depth."""
    t = from_the_first_instant(100.0)
    _, out = heat(wall((material(), DEEP_M)), flight(t, q_add_W_m2=Q_W_M2), (SENSOR_M,), NODES)
    source = f"{CARSLAW}, 2.9: (2 q/k) sqrt(a t) ierfc(x / 2 sqrt(a t))"
    return [
        of_rise(
            f"half space, constant flux: {where} at 100 s",
            START_K + float(exact.semi_infinite_flux(Q_W_M2, K, A, x, t[-1:])[0]),
            out[-1, column],
            source,
        )
        for where, x, column in (("surface", 0.0, 0), ("5 mm", SENSOR_M, 2))
    ]


def half_space_rising_flux() -> list[Row]:
    """Half space under a flux in proportion to time, at steps of 1 s."""
    t = np.linspace(0.0, 100.0, 101)
    _, out = heat(wall((material(), DEEP_M)), flight(t, q_add_W_m2=100.0 * t), nodes=NODES)
    expected = START_K + float(exact.semi_infinite_linear_flux(100.0, K, A, t[-1:])[0])
    source = f"{CARSLAW}, 2.9: 4 s t^1.5 sqrt(a) / (3 k sqrt(pi))"
    return [
        of_rise("half space, flux in proportion to time: surface at 100 s, steps of 1 s", expected, out[-1, 0], source)
    ]


def half_space_film() -> list[Row]:
    """Half space under a film to gas."""
    t, h, T_gas = from_the_first_instant(100.0), 200.0, 1300.0
    _, out = heat(wall((material(), DEEP_M)), flight(t, **film(h, T_gas)), (SENSOR_M,), NODES, parameters=RATIO_ONE)
    rows = []
    for where, x, column in (("surface", 0.0, 0), ("5 mm", SENSOR_M, 2)):
        expected = START_K + (T_gas - START_K) * float(exact.semi_infinite_film(h, K, A, x, t[-1:])[0])
        name = f"half space, film of 200 W/(m2 K): {where} at 100 s"
        rows.append(of_rise(name, expected, out[-1, column], f"{CARSLAW}, 2.7"))
    return rows


def half_space_step() -> list[Row]:
    """Half space after a step of its surface temperature, which a stiff film holds."""
    t, T_face = from_the_first_instant(100.0), 1300.0
    w = wall((material(), DEEP_M))
    _, out = heat(w, flight(t, **film(STIFF_W_M2K, T_face)), (SENSOR_M,), NODES, parameters=RATIO_ONE)
    expected = START_K + (T_face - START_K) * float(erfc(SENSOR_M / (2.0 * math.sqrt(A * 100.0))))
    source = f"{CARSLAW}, 2.4: erfc(x / 2 sqrt(a t))"
    return [of_rise("half space, step of the surface temperature: 5 mm at 100 s", expected, out[-1, 2], source)]


def slab() -> list[Row]:
    """Slab with insulated back under a constant flux, at Fourier number 0.2, and its steady lead over the back."""
    length, t = 0.01, from_the_first_instant(20.0)
    _, out = heat(wall((material(), length)), flight(t, q_add_W_m2=Q_W_M2), (SENSOR_M, length), NODES)
    source = f"{CARSLAW}, 3.8, 2000 terms"
    rows = [
        of_rise(
            f"slab, insulated back, constant flux: {where} at Fo 0.2",
            START_K + float(exact.slab_flux(Q_W_M2, K, A, length, depth, t[-1:], 2000)[0]),
            out[-1, column],
            source,
        )
        for where, depth, column in (("surface", 0.0, 0), ("middle", SENSOR_M, 2), ("back", length, 3))
    ]
    t = np.linspace(0.0, 1000.0, 101)
    _, out = heat(wall((material(), length)), flight(t, q_add_W_m2=Q_W_M2), (length,))
    lead = "q L / 2k, the steady part of the series"
    is_ = "emittance of 1e-9: 1e-6 K"
    rows.append(Row("slab, steadily warming: surface less back", 50.0, out[-1, 0] - out[-1, 2], 2e-6, "K", lead, is_))
    return rows


def heisler() -> list[Row]:
    """Plane wall under a film at Biot number 1, Fourier number 1: published one-term values."""
    length, T_gas, t = 0.01, 1300.0, from_the_first_instant(100.0)
    w = wall((material(), length))
    _, out = heat(w, flight(t, **film(K / length, T_gas)), (length,), NODES, parameters=RATIO_ONE)
    zeta, C1 = 0.8603, 1.1191
    left = C1 * math.exp(-(zeta**2))
    source = "Incropera & DeWitt, table 5.1, Bi 1: zeta 0.8603 rad, C1 1.1191"
    is_ = "four digits of zeta and C1: 1.5e-4 of the step; mesh 1e-4"
    return [
        Row(f"plane wall, Bi 1: {where} at Fo 1", T_gas - 1000.0 * left * shape, out[-1, column], 0.2, "K", source, is_)
        for where, shape, column in (("insulated face", 1.0, 2), ("heated face", math.cos(zeta), 0))
    ]


def decaying_mode() -> list[Row]:
    """A cosine between insulated faces."""
    mesh, length, t = even_mesh(0.01, 40), 0.01, np.linspace(0.0, 20.0, 401)
    ensemble = Ensemble([PointModel("wall", wall((material(), length)))], [mesh], 0.05)
    ensemble.set_profile(0, 800.0 + 100.0 * exact.cosine_decay(A, length, 1, mesh.depth_m, 0.0))
    ensemble.march(t, flight(t))
    expected = 800.0 + 100.0 * math.exp(-(math.pi**2) * 0.2)
    source = f"{CARSLAW}, 3.3: cos(pi x/L) exp(-pi^2 Fo)"
    is_ = "second order in time at 0.05 s: (lambda dt)^2 lambda t / 24, 1e-5 of 100 K"
    got = ensemble.node_temperatures(0)[0]
    return [Row("decaying cosine between insulated faces: x = 0 at Fo 0.2", expected, got, 2e-3, "K", source, is_)]


def periodic_flux() -> list[Row]:
    """Half space under a sinusoidal flux: amplitude and phase of the surface once the start is forgotten."""
    period, amplitude = 100.0, 1e4
    omega, t = 2.0 * math.pi / period, np.linspace(0.0, 4000.0, 8001)
    w = wall((material(), 0.4), initial_K=800.0)
    _, out = heat(w, flight(t, q_add_W_m2=amplitude * np.sin(omega * t)))
    last = t >= t[-1] - period
    wave = np.trapezoid((out[last, 0]) * np.exp(-1j * omega * t[last]), t[last]) * 2.0 / period * 1j
    source = f"{CARSLAW}, 2.6: amplitude q0 sqrt(a/omega) / k, lag 45 deg"
    start = "the start, which decays as t^-1.5: 1e-3 after 40 periods; mesh 3e-4"
    name, expected = "half space, sinusoidal flux of 100 s, surface", amplitude * math.sqrt(A / omega) / K
    return [
        within(2e-3, f"{name}: amplitude", expected, abs(wave), "K", source, start),
        Row(f"{name}: lag", 45.0, -math.degrees(np.angle(wave)), 0.1, "deg", source, start),
    ]


def coated() -> list[Row]:
    """A coating on an insulator, constant flux: the series of a coating on a half space."""
    coat, tile, delta = material(1.0, 1100.0, 1666.0), material(0.06, 1100.0, 144.0), 0.00038
    e_coat, e_tile = (math.sqrt(k * rho * 1100.0) for k, rho in ((1.0, 1666.0), (0.06, 144.0)))
    rows = []
    for end in (1.0, 100.0):
        t = from_the_first_instant(end)
        _, out = heat(wall((coat, delta), (tile, 0.08)), flight(t, q_add_W_m2=Q_W_M2), nodes=200)
        rise = exact.coated_surface(Q_W_M2, e_coat, 1.0 / (1666.0 * 1100.0), e_tile, delta, t[-1:])
        source, is_ = f"{CARSLAW}, 12.8: series in b^n ierfc(n delta / sqrt(a t))", "200 nodes, 5e-4 of the rise"
        name = f"coating on an insulator, constant flux: surface at {end:g} s"
        rows.append(of_rise(name, START_K + float(rise[0]), out[-1, 0], source, 5e-4, is_))
    return rows


def steady() -> list[Row]:
    """Steady states: contact resistance, layers in series, conductivity that depends on temperature."""
    t = np.linspace(0.0, 20000.0, 201)
    cooled = {"h_W_m2K": 50.0, "T_K": 300.0}
    w = wall((material(), 0.005), (material(2.0), 0.004), contact=2e-3, back=cooled)
    ensemble, out = heat(w, flight(t, q_add_W_m2=Q_W_M2), nodes=20)
    at = int(np.flatnonzero(ensemble.meshes[0].layer == -1)[0])
    above, below = ensemble.node_temperatures(0)[at : at + 2]
    settled = "settled to rounding"
    series = START_K + Q_W_M2 * (0.005 + 2e-3 + 0.002 + 0.02)
    rows = [
        Row("contact of 2e-3 m2 K/W: drop", 20.0, above - below, 1e-6, "K", "q R", settled),
        Row("layers, contact, film in series: surface", series, out[-1, 0], 1e-6, "K", "sum of resistances", settled),
    ]
    k, length, back, q = [[300.0, 0.5], [1300.0, 2.0]], 0.02, 1e4, 3e4
    t = np.linspace(0.0, 1e5, 1001)
    w = wall((material(k), length), back={"h_W_m2K": back, "T_K": 300.0})
    _, out = heat(w, flight(t, q_add_W_m2=q), (length,), nodes=14)
    inner = q / back
    # 0.5 s + 0.75e-3 s^2 is the Kirchhoff integral from 300 K to 300 K + s
    target = q * length + 0.5 * inner + 0.75e-3 * inner**2
    surface = 300.0 + (-0.5 + math.sqrt(0.25 + 4.0 * 0.75e-3 * target)) / (2.0 * 0.75e-3)
    source = "Kirchhoff: q L = integral of k dT"
    rows.append(
        Row("k from 0.5 to 2 W/(m K) in 1000 K, steady: surface", surface, out[-1, 0], 1e-5, "K", source, settled)
    )
    return rows


def porous() -> list[Row]:
    """Conductivity between two pressures of a table, steadily."""
    k = PressureTable(p_Pa=[10.0, 1000.0], T_K=[300.0, 1300.0], k=[[0.1, 0.3], [0.1, 0.3]])
    porous = material().model_copy(update={"conductivity_W_mK": k})
    t, q, length = np.linspace(0.0, 1e5, 1001), 1e3, 0.02
    w = wall((porous, length), back={"h_W_m2K": 50.0, "T_K": START_K})
    _, out = heat(w, flight(t, q_add_W_m2=q, p_surface_Pa=100.0), nodes=14)
    expected = START_K + q * (length / 0.2 + 1.0 / 50.0)
    source = "k linear in log10 p: 0.2 W/(m K) at 100 Pa"
    return [Row("porous layer at 100 Pa, steady surface", expected, out[-1, 0], 1e-5, "K", source, "settled: rounding")]


def moisture() -> list[Row]:
    """A thin plate that gives off its moisture: latent heat over a width of temperature."""
    latent, q, thickness, end = 2e5, 1e4, 0.001, 60.0
    wet = {
        "stack.moisture.latent_J_kg": latent,
        "stack.moisture.boil_K": 373.0,
        "stack.moisture.width_K": 5.0,
    }
    t = np.linspace(0.0, end, 601)
    _, out = heat(wall((material(1e4), thickness)), flight(t, q_add_W_m2=q), nodes=14, parameters=wet)
    expected = START_K + q * end / (RHO_C * thickness) - latent / 1000.0
    source, is_ = "rho d (c rise + L) = q t", "tolerance of the control of steps"
    return [Row("plate that has dried, latent heat of 2e5 J/kg: at 60 s", expected, out[-1, 0], 0.02, "K", source, is_)]


def nafems() -> list[Row]:
    """Two thermal benchmarks of NAFEMS: T2, conduction with radiation, and T3, a transient with a sinusoidal face."""
    steel = material(55.563, 460.0, 7850.0, 0.98)
    t = np.linspace(0.0, 20000.0, 401)
    held = {"h_W_m2K": STIFF_W_M2K, "T_K": 1000.0}
    w = wall((steel, 0.1), back=held, surroundings_K=300.0, initial_K=1000.0)
    _, out = heat(w, flight(t), nodes=40)
    published = "NAFEMS, Standard NAFEMS Benchmarks (TNSB, 1990)"
    digits = "one decimal is published: 0.05 K"
    rows = [
        Row(
            "NAFEMS T2, bar at 1000 K radiating at its end: end",
            927.0,
            out[-1, 0],
            0.05,
            "K",
            f"{published}, T2",
            digits,
        )
    ]

    def unbalanced(T: float) -> float:
        return 55.563 * (1000.0 - T) / 0.1 - 0.98 * exact.SIGMA * (T**4 - 300.0**4)

    own = float(brentq(unbalanced, 500.0, 999.0))
    stiff = "film of 1e7 W/(m2 K) in place of a held face: 4 mK"
    rows.append(
        Row(
            "the same bar, flux balance solved",
            own,
            out[-1, 0],
            0.005,
            "K",
            "k (1000 - T) / L = eps sigma (T^4 - 300^4)",
            stiff,
        )
    )
    t, zero = np.linspace(0.0, 32.0, 3201), 273.15
    w = wall((material(35.0, 440.5, 7200.0), 0.1), back={"h_W_m2K": STIFF_W_M2K, "T_K": zero}, initial_K=zero)
    face = zero + 100.0 * np.sin(math.pi * t / 40.0)
    _, out = heat(w, flight(t, **film(STIFF_W_M2K, face)), (0.02,), NODES, parameters=RATIO_ONE)
    digits = "two decimals are published; the target is of a 1990 solution: 0.1 K"
    rows.append(
        Row(
            "NAFEMS T3, 100 sin(pi t/40) C at one face: 0.08 m at 32 s",
            36.60,
            out[-1, 2] - zero,
            0.1,
            "C",
            f"{published}, T3",
            digits,
        )
    )
    rows.append(
        Row(
            "the same bar, eigenfunctions",
            t3_by_eigenfunctions(),
            out[-1, 2] - zero,
            0.01,
            "C",
            "own series of 400 sines",
            "mesh 1e-4 of 100 K",
        )
    )
    return rows


def nafems_on_coarse_meshes() -> list[Row]:
    """NAFEMS T3 on the mesh that a flight is run with, and how its error falls as mesh and samples are refined."""
    zero, exact_C = 273.15, t3_by_eigenfunctions()
    bar = wall((material(35.0, 440.5, 7200.0), 0.1), back={"h_W_m2K": STIFF_W_M2K, "T_K": zero}, initial_K=zero)

    def at_32_s(nodes: int | None, sample_s: float) -> float:
        t = np.linspace(0.0, 32.0, round(32.0 / sample_s) + 1)
        face = zero + 100.0 * np.sin(math.pi * t / 40.0)
        _, out = heat(bar, flight(t, **film(STIFF_W_M2K, face)), (0.02,), nodes, parameters=RATIO_ONE)
        return float(out[-1, 2] - zero)

    source = "own series of 400 sines"
    # A film of 1e7 W/(m2 K) in place of the held faces leaves 0.007 K on any mesh.
    finest = at_32_s(400, 0.05)
    off = {n: at_32_s(n, 0.05) - finest for n in (25, 50, 100)}
    return [
        Row("NAFEMS T3 on the mesh that is chosen by itself, the face sampled every 1 s", exact_C, at_32_s(None, 1.0),
            0.3, "C", source, "chosen mesh: 0.3 K; it has 14 nodes here, 0.11 K; samples of the face: 0.02 K"),
        Row("NAFEMS T3, 50 nodes, the face sampled every 0.25 s", exact_C, at_32_s(50, 0.25), 0.02, "C", source,
            "second-order error of 50 nodes, and of a film in place of held faces"),
        *(within(0.2, f"NAFEMS T3, distance of {n} nodes from 400 over that of {2 * n}", 4.0, off[n] / off[2 * n], "-",
                 "second order", "higher orders") for n in (25, 50)),
    ]  # fmt: skip


def t3_by_eigenfunctions() -> float:
    """NAFEMS T3 by Duhamel's integral of the sine series [C]: 0.08 m from the cold face, 32 s."""
    a, length, x, t, omega = 35.0 / (440.5 * 7200.0), 0.1, 0.08, 32.0, math.pi / 40.0
    n = np.arange(1, 401)
    decay = a * (n * math.pi / length) ** 2
    # v = T - face x/L obeys v_t = a v_xx - face' x/L; x/L = sum 2 (-1)^(n+1) / (n pi) sin(n pi x/L)
    forced = 100.0 * omega * (decay * math.cos(omega * t) + omega * math.sin(omega * t) - decay * np.exp(-decay * t))
    modes = -2.0 * (-1.0) ** (n + 1) / (n * math.pi) * forced / (decay**2 + omega**2)
    return float(100.0 * math.sin(omega * t) * x / length + np.sum(modes * np.sin(n * math.pi * x / length)))


def narrow_peak() -> list[Row]:
    """A thin plate through a peak of its specific heat 10 K wide: its heat content against the table's integral."""
    thickness, q = 0.001, 1e4
    c = [[300.0, 1000.0], [498.0, 1000.0], [503.0, 21000.0], [508.0, 1000.0], [900.0, 1000.0]]
    t = np.linspace(0.0, 40.0, 4001)
    w = wall((material(1e4, c), thickness))
    _, out = heat(w, flight(t, q_add_W_m2=q), nodes=14)

    def excess(T: float, heat_J_kg: float) -> float:
        points = np.unique([START_K, T, *(x for x, _ in c if START_K < x < T)])
        return float(np.trapezoid(np.interp(points, *np.array(c).T), points)) - heat_J_kg

    contract = "tables are stored to 0.01 K; steps of 0.01 s"
    source = "integral of c(T) dT = q t / (rho d), c as declared"
    return [
        Row(
            f"plate through a 10 K wide peak of cp: at {at:g} s",
            float(brentq(excess, START_K, 900.0, (q * at / (1000.0 * thickness),), xtol=1e-9)),
            float(np.interp(at, t, out[:, 0])), 0.01, "K", source, contract,
        )
        for at in (20.4, 21.0, 40.0)
    ]  # fmt: skip


def rows() -> list[Row]:
    """All of this subject."""
    parts = (
        half_space_flux, half_space_rising_flux, half_space_film, half_space_step, slab, heisler,
        decaying_mode, periodic_flux, coated, steady, porous, moisture, nafems, nafems_on_coarse_meshes,
        narrow_peak,
    )  # fmt: skip
    return [row for part in parts for row in part()]
