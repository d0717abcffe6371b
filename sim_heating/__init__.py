"""Aerodynamic heating alongside a flight simulator: temperatures from a trajectory, heating from temperatures.

    import sim_heating as sh

    flown = sh.run("scenarios/popu_mach20.toml")                       # fly, heat, march
    records = sh.synthesize("scenarios/popu_mach20.toml")              # the same flight as thermocouples see it
    fit = sh.estimate(records["V09T9527"])                             # heating derivatives with bounds
    closed = sh.close_loop(sh.load_record("scenarios/records/practice/p08"))  # the effect that a model lacks

Names are imported when they are first used, so that `import sim_heating` costs nothing. Everything that is not in
`__all__` may move between releases.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim_heating.base.errors import InputError as InputError
    from sim_heating.base.errors import RunError as RunError
    from sim_heating.base.kernels.jit import njit as njit
    from sim_heating.base.parameters import Parameter as Parameter
    from sim_heating.campaign.figures.paper import draw_figures as draw_figures
    from sim_heating.campaign.figures.paper import write_figures as write_figures
    from sim_heating.closure.close import close_loop as close_loop
    from sim_heating.closure.close import close_loops as close_loops
    from sim_heating.closure.close import write_closed_loop as write_closed_loop
    from sim_heating.closure.close import write_joint_loop as write_joint_loop
    from sim_heating.closure.prior.model_error import stated_error as stated_error
    from sim_heating.closure.revise.report import update_tables as update_tables
    from sim_heating.estimation.design.report import design as design
    from sim_heating.estimation.design.report import write_design as write_design
    from sim_heating.estimation.fit import estimate as estimate
    from sim_heating.estimation.parameter_list import parameter_list as parameter_list
    from sim_heating.estimation.report.report import write_fit as write_fit
    from sim_heating.heating.effects import Effect as Effect
    from sim_heating.heating.effects import SearchStart as SearchStart
    from sim_heating.heating.effects import effects as effects
    from sim_heating.heating.effects import flight as flight
    from sim_heating.heating.effects import model_parameter as model_parameter
    from sim_heating.heating.exchange.dave_ml import read_dave_ml as read_dave_ml
    from sim_heating.heating.exchange.dave_ml import write_dave_ml as write_dave_ml
    from sim_heating.inputs.record import load_record as load_record
    from sim_heating.inputs.scenario import load_scenario as load_scenario
    from sim_heating.inputs.vehicle import load_vehicle as load_vehicle
    from sim_heating.planning.plan import plan as plan
    from sim_heating.simulation.fmu_export.export import export_fmu as export_fmu
    from sim_heating.simulation.fmu_export.ssp import export_ssp as export_ssp
    from sim_heating.simulation.plugin import HeatingPlugin as HeatingPlugin
    from sim_heating.simulation.plugin_jsbsim import JSBSimHeating as JSBSimHeating
    from sim_heating.simulation.predict import predict as predict
    from sim_heating.simulation.predict import write_prediction as write_prediction
    from sim_heating.simulation.run import run as run
    from sim_heating.simulation.run import write_run as write_run
    from sim_heating.simulation.synthesize import synthesize as synthesize
    from sim_heating.simulation.synthesize import write_records as write_records
    from sim_heating.trajectory.jsbsim.host import InitialState as InitialState
    from sim_heating.trajectory.jsbsim.host import JSBSimHost as JSBSimHost
    from sim_heating.trajectory.jsbsim.host import PropertyRead as PropertyRead
    from sim_heating.trajectory.spec import Dispersions as Dispersions

    __version__: str

_HOME = {
    # what a user declares
    "load_vehicle": "inputs.vehicle",
    "load_scenario": "inputs.scenario",
    "load_record": "inputs.record",
    # simulate
    "run": "simulation.run",
    "synthesize": "simulation.synthesize",
    "predict": "simulation.predict",
    "HeatingPlugin": "simulation.plugin",
    "export_fmu": "simulation.fmu_export.export",
    "export_ssp": "simulation.fmu_export.ssp",
    # any aircraft of JSBSim, with the heating alongside
    "JSBSimHost": "trajectory.jsbsim.host",
    "JSBSimHeating": "simulation.plugin_jsbsim",
    "InitialState": "trajectory.jsbsim.host",
    "PropertyRead": "trajectory.jsbsim.host",
    "Dispersions": "trajectory.spec",
    # estimate, and close the loop
    "estimate": "estimation.fit",
    "stated_error": "closure.prior.model_error",
    "parameter_list": "estimation.parameter_list",
    "design": "estimation.design.report",
    "close_loop": "closure.close",
    "close_loops": "closure.close",
    "update_tables": "closure.revise.report",
    # the founding paper's figures over flights
    "draw_figures": "campaign.figures.paper",
    # plan
    "plan": "planning.plan",
    # models of other programs
    "read_dave_ml": "heating.exchange.dave_ml",
    "write_dave_ml": "heating.exchange.dave_ml",
    # write results into a directory, all files or none
    "write_run": "simulation.run",
    "write_records": "simulation.synthesize",
    "write_prediction": "simulation.predict",
    "write_fit": "estimation.report.report",
    "write_design": "estimation.design.report",
    "write_closed_loop": "closure.close",
    "write_joint_loop": "closure.close",
    "write_figures": "campaign.figures.paper",
    # effects, those of users among them
    "Effect": "heating.effects",
    "SearchStart": "heating.effects",
    "effects": "heating.effects",
    "flight": "heating.effects",
    "model_parameter": "heating.effects",
    "Parameter": "base.parameters",
    "njit": "base.kernels.jit",
    # what can go wrong
    "InputError": "base.errors",
    "RunError": "base.errors",
}
"""Public name -> module that defines it."""

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until a program asks for what is logged

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from sim_heating.base.files.package import package_version

        return package_version()
    if name not in _HOME:
        raise AttributeError(f"module `sim_heating` has no attribute `{name}`")
    return getattr(import_module(f"sim_heating.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
