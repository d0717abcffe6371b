"""What an effect consists of: its parameters, its kernel, and where the search for it in data starts."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Literal, get_args, get_type_hints

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import EXTRAS, HEATING, STATE, Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import raise_problems, suggestion
from sim_heating.base.kernels.block import EFFECT_SLOTS, EFFECT_WIDTH
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import MODEL, RECORD_PARAMETERS, Parameter, is_number
from sim_heating.heating import flight_variables

NEEDED_COLUMNS = (*STATE, *HEATING, "q_add_W_m2", "jets", "qbar_Pa", *EXTRAS)
"""Columns of the flight conditions that an effect may need: those of every flight, and the optional ones."""
KERNEL_ARGUMENTS = ("B", "c", "p", "wall_K")
"""Arguments of a kernel: the numbers of a lane, where its conditions begin, where the effect's parameters begin, K."""


@dataclass(frozen=True)
class SearchStart:
    """One start of the search for an effect: the parameters estimated together, and where the search begins.

    names  : parameters of the effect that are estimated together
    values : initial values of any of its parameters, each in its own unit; else the neutral value, or else the nominal

    A start at which the effect is neutral is best: the sensitivity to its magnitude there gives to first order how much
    the effect would reduce the error.
    """

    names: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelParameter(Parameter):
    """A parameter of an effect of mode "model": a parameter of the model under the effect's own name for it.

    stands_for : dotted name of the model's parameter, such as `stack.gap.fraction`
    """

    stands_for: str = ""


def model_parameter(name: str, stands_for: str, text: str = "", **changes: float) -> ModelParameter:
    """Parameter of the model under an effect's own name for it; unit, nominal value, prior and bounds are the model's.

    name       : name within the effect
    stands_for : dotted name of the model's parameter, such as `stack.gap.fraction` or `clock.skew`
    text       : what it is, in a line; that of the model's parameter by default
    changes    : `value`, `sigma`, `lower` or `upper` in its unit ([-], [m] ...), where the effect needs another than
                 the model
    raises     : InputError with the nearest known name where the model has no such parameter
    """
    parameters = {**MODEL, **RECORD_PARAMETERS}
    if stands_for not in parameters:
        raise InputError(f"parameter `{name}`: the model has no `{stands_for}`{suggestion(stands_for, parameters)}")
    model = parameters[stands_for]
    return ModelParameter(**asdict(model) | {"name": name, "text": text or model.text} | changes, stands_for=stands_for)


@dataclass(frozen=True)
class Window:
    """A range of one flight condition within which an effect acts.

    name      : what the effect is called there, after its own name
    variable  : flight condition by the name of its column, one that kernels read (heating/flight_variables.py)
    low, high : ends of the range, in the unit of the column
    ramp      : width of the rise from nothing at either end to all of the effect, within the range, in that unit; 0 for
                a jump
    raises    : InputError where the range or the ramp is none, or kernels do not read the variable
    """

    name: str
    variable: str
    low: float
    high: float
    ramp: float = 0.0

    def __post_init__(self) -> None:
        variables = [name for name, index in vars(flight_variables).items() if isinstance(index, int)]
        if self.variable not in variables:
            raise InputError(
                f"window `{self.name}`: effects do not read a flight condition `{self.variable}`"
                f"{suggestion(self.variable, variables)}"
            )
        if not self.low < self.high:
            raise InputError(f"window `{self.name}`: low is {self.low:g} and high {self.high:g}; low is below high")
        widest = 0.5 * (self.high - self.low)
        if not 0.0 <= self.ramp <= widest:
            raise InputError(f"window `{self.name}`: ramp is {self.ramp:g}; give 0 to {widest:g}, half the range")


@dataclass(frozen=True)
class Effect:
    """An effect on the heating, on the emittance, or on parameters of the model.

    name          : as in a closure report
    mode          : "add" to the ratio; "multiply" the ratio, after everything that adds; "emittance"; or "model"
    parameters    : in the order in which the kernel reads them, EFFECT_WIDTH at most; of mode "model": ModelParameters
    kernel        : compiled f(B, c, p, wall_K); None for an effect of mode "model"
    needs_wall    : whether the kernel's value depends on the wall temperature
    reads_ratio   : whether it depends on the heating ratio that it multiplies; the film is then not affine in the ratio
    lags          : whether the ratio lags; the first two parameters are then time constant [s] and fraction [-]
    remembers     : whether its value depends on conditions before the present ones in another way
    needs         : columns of the flight conditions (NEEDED_COLUMNS) that must exist and vary for the effect to be
                    identifiable; `close-loop` does not look for it in other flights
    neutral       : its magnitudes and the values at which, all of them together, it does nothing for any other
                    parameters
    search_starts : starts of the search for it in data, for a flight's conditions; by default one, with all parameters
                    that have a prior, from their nominal values
    search_bounds : narrower bounds of some parameters in the search for it, those that are physical
    last_resort   : whether `close-loop` looks for it only where no other effect is adequate
    of_flow       : parameters of the flow around the vehicle rather than of one point, such as an onset: records of
                    neighbouring points may have them in common
    of_flight     : parameters of one flight, such as the time of an event: no two records have them in common
    physics       : the physical process, in a line
    source        : publication or flight in which it was seen
    window        : range of a flight condition within which it acts; None: always
    raises        : InputError where parameters are too many, mode and kernel or parameters contradict each other, or
                    `neutral` names a parameter, or `needs` a column, that does not exist

    >>> import sim_heating as sh
    >>> depth = sh.model_parameter("depth_m", "stack.gap.depth_m")
    >>> effect = sh.Effect("deep-gap", "model", (sh.model_parameter("fraction", "stack.gap.fraction"), depth))
    >>> effect.model_parameters
    ('stack.gap.fraction', 'stack.gap.depth_m')
    """

    name: str
    mode: Literal["add", "multiply", "emittance", "model"]
    parameters: tuple[Parameter, ...]
    kernel: Callable[..., float] | None = field(default=None, compare=False)
    needs_wall: bool = False
    reads_ratio: bool = False
    lags: bool = False
    remembers: bool = False
    needs: tuple[str, ...] = ()
    neutral: Mapping[str, float] = field(default_factory=dict, compare=False)
    search_starts: Callable[[Conditions], Sequence[SearchStart]] | None = field(default=None, compare=False)
    search_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict, compare=False)
    last_resort: bool = False
    of_flow: tuple[str, ...] = ()
    of_flight: tuple[str, ...] = ()
    physics: str = ""
    source: str = ""
    window: Window | None = None

    def __post_init__(self) -> None:
        self._check_kinds()
        for name in ("parameters", "needs", "of_flow", "of_flight"):  # lists cannot be hashed
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if len(self.parameters) > EFFECT_WIDTH:
            raise InputError(f"effect {self.name}: {len(self.parameters)} parameters; {EFFECT_WIDTH} at most")
        self._check_mode()
        for p in self.parameters:
            if not (p.lower <= p.value <= p.upper and p.sigma >= 0.0):
                raise InputError(
                    f"effect {self.name}, parameter {p.name}: value {p.value:g}, sigma {p.sigma:g}, bounds {p.lower:g} "
                    f"to {p.upper:g}; sigma must be 0 or above, and the value within its bounds"
                )
        for name in ("neutral", "search_bounds", "of_flow", "of_flight"):
            self._check_names(getattr(self, name), name)
        for column in self.needs:
            if column not in NEEDED_COLUMNS:
                raise InputError(
                    f"effect {self.name}, `needs`: flight conditions have no column `{column}`"
                    f"{suggestion(column, NEEDED_COLUMNS)}"
                )

    @property
    def built_in(self) -> bool:
        """Whether its kernel is one of the package's; False for a user-defined one and for mode "model"."""
        return getattr(self.kernel, "__module__", "").startswith(f"{__package__}.")

    @property
    def model_parameters(self) -> tuple[str, ...]:
        """Dotted names of the model's parameters ([-], [s] ...) that its own stand for, in their order; none with a
        kernel."""
        return tuple(p.stands_for for p in self.parameters if isinstance(p, ModelParameter))

    @property
    def acts_on_readings(self) -> bool:
        """Whether it changes a record's readings alone, its clock or a lag: such an effect has no part in the march."""
        return any(name in RECORD_PARAMETERS for name in self.model_parameters)

    def own_name(self, model_name: str) -> str | None:
        """Name within this effect of a parameter of the model, such as `skew_s` of `clock.skew`.

        model_name : dotted name of the parameter in the model
        returns    : name in the effect; None where the effect does not set this parameter
        """
        return dict(zip(self.model_parameters, (p.name for p in self.parameters), strict=False)).get(model_name)

    def search_definitions(self) -> tuple[Parameter, ...]:
        """Definitions of the parameters, each in its unit ([-], [s], [K] ...), in the search for the effect, within
        `search_bounds`."""
        bounds = self.search_bounds
        return tuple(
            replace(p, lower=bounds[p.name][0], upper=bounds[p.name][1]) if p.name in bounds else p
            for p in self.parameters
        )

    def starts_for(self, flown: Conditions) -> Sequence[SearchStart]:
        """Starts of the search for this effect, each value in the unit of its parameter ([-], [s], [K] ...), in a
        flight's data.

        flown   : conditions of the flight, over which onsets and times are spread
        returns : starts, each completed with the effect's neutral values
        raises  : InputError where a start names a parameter that the effect does not have
        """
        if self.search_starts is None:
            return [SearchStart(tuple(p.name for p in self.parameters if p.sigma > 0.0))]
        starts = self.search_starts(flown)
        self._check_names([n for s in starts for n in (*s.names, *s.values)], "search_starts")
        return [replace(s, values={**self.neutral, **s.values}) for s in starts]

    def active_parameters(self, names: Sequence[str], values: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters that change the heating at given values, each in its unit ([-], [s], [K] ...): where the effect is
        neutral there, its magnitudes only.

        names   : parameters of the effect
        values  : value of each parameter, in its unit
        returns : those of `names` with a sensitivity that is not identically zero
        """
        neutral = bool(self.neutral) and all(values[n] == value for n, value in self.neutral.items())
        return tuple(n for n in names if n in self.neutral or not neutral)

    def _check_mode(self) -> None:
        """raises : InputError where a kernel or the parameters do not go with the mode"""
        if (self.mode == "model") != (self.kernel is None):
            raise InputError(
                f'effect {self.name}: mode "{self.mode}" {"takes no" if self.kernel else "needs a"} kernel; '
                'every mode but "model" has one'
            )
        if self.mode == "model" and len(self.model_parameters) != len(self.parameters):
            raise InputError(
                f'effect {self.name}: mode "model" takes parameters of the model; make each with model_parameter(...)'
            )

    def _check_kinds(self) -> None:
        """raises : InputError where a field is not of its kind, which a file of Python does not exclude"""
        modes = get_args(get_type_hints(Effect)["mode"])
        kinds: tuple[tuple[str, str, object], ...] = (
            ("name", "a text", isinstance(self.name, str) and self.name.strip()),
            ("mode", f"one of {', '.join(modes)}", self.mode in modes),
            ("parameters", "Parameters in a tuple", _all_are(self.parameters, Parameter)),
            ("kernel", "a function of @njit, or None", _is_function_or_none(self.kernel)),
            ("needs", "names of columns in a tuple", _all_are(self.needs, str)),
            ("of_flow", "names of parameters in a tuple", _all_are(self.of_flow, str)),
            ("of_flight", "names of parameters in a tuple", _all_are(self.of_flight, str)),
            ("neutral", "numbers by parameter", _are_numbers_by_name(self.neutral)),
            ("search_starts", "a function", _is_function_or_none(self.search_starts)),
            ("physics", "a text", isinstance(self.physics, str)),
            ("source", "a text", isinstance(self.source, str)),
        )
        raise_problems(
            [f"effect {self.name}, `{f}`: {getattr(self, f)!r} is not {kind}" for f, kind, holds in kinds if not holds]
        )
        self._check_arguments()

    def _check_arguments(self) -> None:
        """raises : InputError where the kernel takes other arguments than (B, c, p, wall_K)"""
        if self.kernel is None:
            return
        function = getattr(self.kernel, "py_func", self.kernel)
        try:
            signature = inspect.signature(function)
            signature.bind(*KERNEL_ARGUMENTS)
        except TypeError:
            called = f"{function.__name__}({', '.join(signature.parameters)})"
            raise InputError(
                f"effect {self.name}, `kernel`: {called} takes other arguments than a kernel; "
                f"write {function.__name__}({', '.join(KERNEL_ARGUMENTS)})"
            ) from None

    def _check_names(self, names: Iterable[str], where: str) -> None:
        """raises : InputError where one of the names is not a parameter of this effect"""
        declared = [p.name for p in self.parameters]
        for name in names:
            if name not in declared:
                raise InputError(
                    f"effect {self.name}, `{where}`: no parameter `{name}`. The effect has: {', '.join(declared)}."
                )


def _is_function_or_none(value: object) -> bool:
    return value is None or callable(value)


def _are_numbers_by_name(value: object) -> bool:
    return isinstance(value, Mapping) and all(is_number(v) and v == v for v in value.values())


def _all_are(values: object, kind: type) -> bool:
    return isinstance(values, (tuple, list)) and all(isinstance(v, kind) for v in values)


@njit
def share_within(v: float, low: float, high: float, ramp: float) -> float:
    """Part of an effect [-] that acts at the value v of its window's variable, from 0 to 1.

    v, low, high, ramp : in the unit of the variable. Source: docs/reference/effects.md, equation 30.
    """
    inside = min(v - low, high - v)
    if inside < 0.0:
        return 0.0
    return inside / ramp if inside < ramp else 1.0


@cache
def effect_within(always: Effect, window: Window) -> Effect:
    """An effect within a window; it is called `NAME-WINDOW`, and its parameters are those of the effect.

        f_w = n + w (f - n),    w = min(1, max(0, min(v - low, high - v) / ramp))

    always : an effect with a kernel and without memory;  window : range of a flight condition v, in its unit ([-],
             [K], [s] ...)
    raises : InputError where the effect takes no window

    n is the value of no effect, 0 of what adds to the ratio and 1 of a factor. docs/reference/effects.md, equation 30.
    """
    name = always.name
    if always.kernel is None:
        raise InputError(f"effect {name}: takes no window, as it sets parameters of the model; remove `window`")
    if always.lags or always.remembers:
        raise InputError(f"effect {name}: takes no window, as it has a memory; remove `window`")
    kernel, neutral = always.kernel, 0.0 if always.mode == "add" else 1.0
    index, low, high, ramp = getattr(flight_variables, window.variable), window.low, window.high, window.ramp

    def within(B: FloatArray, c: int, p: int, wall_K: float) -> float:
        weight = share_within(B[c + index], low, high, ramp)
        if weight == 0.0:
            return neutral
        return neutral + weight * (kernel(B, c, p, wall_K) - neutral)

    needs = dict.fromkeys((*always.needs, window.variable))
    return replace(
        always, name=f"{name}-{window.name}", kernel=njit(within), window=window, search_starts=None, needs=tuple(needs)
    )


@dataclass(frozen=True)
class EffectUse:
    """An effect with the values of its parameters, each in its unit, in the order of `effect.parameters`.

    declared : definitions of the parameters where a file declares the effect with its own sigma; else the effect's
    """

    effect: Effect
    values: tuple[float, ...]
    declared: tuple[Parameter, ...] = ()

    @property
    def definitions(self) -> tuple[Parameter, ...]:
        """Definitions of the parameters, each in its unit ([-], [s], [K] ...), as declared or as the effect has them,
        in the order of the values."""
        return self.declared or self.effect.parameters

    @property
    def by_name(self) -> dict[str, float]:
        """Value of each parameter, in its unit ([-], [s], [K] ...), by its name within the effect."""
        return {p.name: v for p, v in zip(self.effect.parameters, self.values, strict=True)}


def combined_uses(declared: Iterable[EffectUse], replacing: Iterable[EffectUse]) -> tuple[EffectUse, ...]:
    """Effects of a point: those declared, or that of the same name in `replacing`; then the rest of `replacing`."""
    new = {u.effect.name: u for u in replacing}
    return (*(new.pop(u.effect.name, u) for u in declared), *new.values())


def check_count(uses: tuple[EffectUse, ...], where: str) -> None:
    """Check that the effects of one control point fit into its lane.

    uses   : effects of the control point; those of mode "model" take no slot
    where  : control point or file, for the message
    raises : InputError where more than EFFECT_SLOTS of them have a kernel
    """
    kernels = sum(use.effect.kernel is not None for use in uses)
    if kernels > EFFECT_SLOTS:
        raise InputError(f"{where}: {kernels} effects with a kernel; {EFFECT_SLOTS} at most at one control point")
