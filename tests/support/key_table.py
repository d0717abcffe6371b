"""The table of the walk over all keys: values to try, and keys whose action another test shows."""

from __future__ import annotations

from typing import Any

VALUES: dict[str, list[Any]] = {
    "Heating.ratio_table": ["other.csv"],
    "CmShift.mach": [[20.0, 30.0]],
    "ControlPointFile.ratio_table": ["ratio_tables/LEE_UPPER.csv", "ratio_tables/STS96_597.csv"],
    "DerivedMaterial.based_on": ["li900"],
    "InterfaceDeclaration.upstream": ["V09T9527"],
    "LinkFile.control_points": [["V09T9527", "NOSE_HRSI"]],
    "Layer.material": ["al2024"],
    "Mass.cg_fraction": [0.655, 0.67],
    "ReferenceHeating.wall_enthalpy": [{"cp_J_kgK": 1004.5}],
    "Envelope.boundary": [[{"name": "other", "along": "drag_factor", "at": [1.0], "across": "alpha_offset_deg",
                            "values": [-8.0, 0.0]}]],
    "FitSettings.start": ["circuit:60"],
    "ParameterSettings.parameters": [["ratio.scale", "stack.coating.thickness_factor", "clock.skew"]],
    "Replay.record": ["second/record"],
    "Dispersion.step_s": [1.0, 0.25],
    "CampaignFile.flight": [[{"scenario": "entry.toml", "seeds": [12]}]],
    "Envelope.bodyflap_above_mach": [30.0],
    "Joint.speed_tolerance": [0.001],
    "Design.after_s": [5.0],
    "Design.parameters": [["ratio.d_elevon"], ["ratio.d_logre"]],
    "DesignLimits.alpha_deg": [[36.0, 41.0]],
    "DesignLimits.qbar_Pa": [[0.0, 100.0]],
    "Target.deadband_deg": [30.0],
    "Target.latitude_deg": [40.0],
}  # fmt: skip
"""Values to try first, by key, where a little more or less does nothing."""
REFUSES: dict[str, str] = {
    "Compare.control_point": "no control point", "Compare.file": "no such file",
    "Design.control_point": "no control point",
    "DeclaredEffect.name": "unknown effect", "FileBase.file": "no such file", "Mass.cg_range": "cg_fraction",
    "ScenarioEffect.name": "unknown effect", "ScenarioFile.vehicle": "unknown vehicle",
    "SelectedFit.control_point": "there is no", "SensorFault.sensor": "unknown sensor",
    "SensorField.control_point": "`sensor`",
    "StudyFile.revision": "the study needs", "DesignVariable.manoeuvre": "there is no manoeuvre",
}  # fmt: skip
"""Keys that name something else, or limit it: what the refusal of another value says where it does not name the key."""

_SHOWN = {
    "tests/trajectory/test_fmu_import.py": (
        "FmuInput.command FmuInput.schedule FmuInput.unit FmuSource.columns FmuSource.inputs FmuSource.interface "
        "FmuSource.start FmuSource.timeout_s FmuSource.tolerance FmuValue.unit FmuValue.value FmuVariable.unit "
        "FmuVariable.variable TrajectorySpec.fmu"
    ),
    "tests/live/test_sources.py": (
        "Mqtt.host Mqtt.kind Mqtt.port Mqtt.topics Mqtt.user Network.host Network.port Packets.apid Packets.container "
        "Packets.kind Packets.xtce JSBSimOutput.fields JSBSimOutput.kind Replay.speed"
    ),
    "tests/live/test_jsbsim_link.py": "JSBSimInput.port JSBSimInput.prefix OutputSettings.jsbsim LinkFile.output",
    "tests/live/test_outputs.py": "JSBSimInput.host OutputSettings.host OutputSettings.metrics OutputSettings.page "
    "OutputSettings.port OutputSettings.lines",
    "tests/live/test_ahead.py": "AheadSettings.every_s AheadSettings.keep AheadSettings.scenario LinkFile.ahead "
    "AheadSettings.heating_error AheadSettings.horizon_s",
    "tests/live/test_engine.py": "OutputSettings.rate_Hz",
    "tests/simulation/test_measured_records.py": "Compare.noise_correlation_s",
    "tests/live/test_live_command.py": "EstimateSettings.jump_s",
    "tests/live/test_journal.py": "JournalSettings.fsync_s LinkFile.journal",
    "tests/planning/test_optimal_entry.py": (
        "OptimalStudyFile.alpha_limits_deg OptimalStudyFile.bank_limits_deg OptimalStudyFile.duration_s "
        "OptimalStudyFile.flight_limits "
        "OptimalStudyFile.end OptimalStudyFile.initial OptimalStudyFile.intervals OptimalStudyFile.limit "
        "OptimalStudyFile.soak_s "
        "OptimalStudyFile.mesh_tolerance OptimalStudyFile.probability OptimalStudyFile.state "
        "OptimalStudyFile.tolerance_K OptimalStudyFile.vehicle FinalState.altitude_m FinalState.gamma_deg "
        "FinalState.velocity_m_s StudyFile.optimal"
    ),
    "tests/credibility/test_statement.py": (
        "Review.date Review.factor Review.level Review.person Review.reviewed Review.statement ReviewFile.review"
    ),
    "tests/campaign/test_campaign.py": "FlightSource.records CampaignFile.ageing",
    "tests/templates/test_loggers.py": (
        "LayoutColumn.depth LayoutColumn.kind LayoutColumn.name LayoutColumn.unit LoggerLayout.column "
        "LoggerLayout.dates LoggerLayout.decimal LoggerLayout.flux_unit LoggerLayout.lost "
        "LoggerLayout.period_s LoggerLayout.repeated "
        "LoggerLayout.separator LoggerLayout.sheet LoggerLayout.temperature_unit LoggerLayout.time "
        "LoggerLayout.time_unit LoggerLayout.title LoggerLayout.thermocouple LoggerLayout.reference_junction"
    ),
    "tests/estimation/test_conditions_noise.py": (
        "ConditionsFile.noise FlightNoise.alpha_deg FlightNoise.density_relative FlightNoise.velocity_relative"
    ),
    "tests/estimation/test_design.py": (
        "InstrumentSet.bits InstrumentSet.name InstrumentSet.prior InstrumentSet.range_K InstrumentSet.rate_hz "
        "InstrumentSet.sensor Design.instruments"
    ),
    "tests/inputs/test_sensors.py": "RateInManoeuvres.elsewhere_hz RateInManoeuvres.manoeuvres_hz",
    "tests/estimation/test_pressure_transducer.py": (
        "PressureTransducer.bias_sigma_Pa PressureTransducer.bits PressureTransducer.column "
        "PressureTransducer.gain_sigma PressureTransducer.name PressureTransducer.noise_sigma_Pa "
        "PressureTransducer.range_Pa PressureTransducer.used Thermocouples.transducer ControlPointFile.transducer "
        "Truth.p_surface_factor InstrumentSet.transducer"
    ),
    "tests/estimation/test_growing_noise.py": "Sensor.noise_per_K",
    "tests/estimation/test_ambient_check.py": (
        "AmbientCheck.T_K AmbientCheck.reading_K AmbientCheck.sigma_K RecordedSensor.ambient_check "
        "Sensor.calibration_sigma_K"
    ),
    "tests/heating/test_effect_window.py": (
        "EffectWindow.high EffectWindow.low EffectWindow.name EffectWindow.ramp EffectWindow.variable "
        "ScenarioEffect.window"
    ),
    "tests/inputs/test_unusual_numbers.py": "Material.apparent",
    "tests/heating/test_flight_fields.py": "TrajectorySpec.fields",
    "tests/planning/test_bands.py": "Envelope.member StudyMember.estimate StudyMember.weight",
    "tests/planning/test_dispersed_members.py": "Dispersion.member",
    "tests/planning/test_envelope.py": "Envelope.refinements Envelope.elevon_arm_m",
    "tests/planning/test_envelope_boundary.py": "EnvelopeBoundary.inside",
}
ELSEWHERE: dict[str, str] = {key: test for test, keys in _SHOWN.items() for key in keys.split()}
"""Keys that act only with a network, a solver, a compiler or another process: the test that shows it."""
