"""Types of the arguments of :mod:`vsgdesign.verbs.facade.studies`, by the fields of a study."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

from vsgdesign.study.parameters.fields import Field
from vsgdesign.study.parameters.study import Study

Quantity = float | str
"""A number in SI, or a text with a unit."""

class StudyTable(TypedDict, total=False):
    """The fields of [study]."""

    name: str
    title: str
    source: str

class ConverterTable(TypedDict, total=False):
    """The fields of [converter]."""

    S_rated: Quantity
    V_rated_ll_rms: Quantity
    V_rated_rms: Quantity
    f_n: Quantity
    V_dc: Quantity
    f_sw: Quantity
    samples_per_carrier: int
    delay_samples: int
    modulation: Literal["sine_triangle", "min_max"]
    current_limit_pu: Quantity
    current_limiter: Literal["circular", "threshold_impedance", "saturation", "hybrid", "projection", "balanced_power"] | str
    limiter: ConverterLimiterTable | Mapping[str, Any]
    V_min_pu: Quantity
    V_max_pu: Quantity

class ConverterLimiterTable(TypedDict, total=False):
    """The fields of [converter.limiter]."""

    threshold_pu: Quantity
    drop_at_limit_pu: Quantity
    impedance_x_over_r: Quantity
    impedance_filter_time: Quantity
    current_angle: Quantity
    feedback_resistance_pu: Quantity
    feedback_reactance_pu: Quantity
    soft_limit_pu: Quantity
    virtual_impedance_pu: Quantity
    filter_time: Quantity
    pull_time: Quantity
    frequency_pull: Quantity
    largest_rocof: Quantity
    frequency_range: Quantity
    gate_voltage_pu: Quantity
    impedance_doubt: Quantity
    V_low_pu: Quantity
    V_high_pu: Quantity
    balance_time: Quantity
    untouched_ripple_pu: Quantity
    negative_sequence_pu: Quantity

class FilterTable(TypedDict, total=False):
    """The fields of [filter]."""

    kind: Literal["LC", "LCL"]
    L_1: Quantity
    R_1: Quantity
    C: Quantity
    R_c: Quantity
    L_2: Quantity
    R_2: Quantity

class InnerLoopsTable(TypedDict, total=False):
    """The fields of [inner_loops]."""

    design: bool
    scr: Sequence[Quantity]
    x_over_r: Sequence[Quantity]
    seed: int
    current_response_time: Quantity
    voltage_response_time: Quantity
    damping_ratio: Quantity
    K_pc: Quantity
    K_ic: Quantity
    K_pv: Quantity
    K_iv: Quantity
    current_feedforward: Quantity
    transient_resistance_pu: Quantity
    transient_reactance_pu: Quantity
    current_prediction: Quantity
    transient_corner: Quantity

class GridTable(TypedDict, total=False):
    """The fields of [grid]."""

    scr_basis: Literal["impedance", "reactance"] | str
    scr: Quantity
    x_over_r: Quantity
    R_g: Quantity
    L_g: Quantity
    V_g_pu: Quantity
    f_g: Quantity
    components: Sequence[GridComponentsTable | Mapping[str, Any]]

class GridComponentsTable(TypedDict, total=False):
    """The fields of [grid.components]."""

    order: Quantity
    amplitude_pu: Quantity
    phase: Quantity

class NetworkTable(TypedDict, total=False):
    """The fields of [network]."""

    load: NetworkLoadTable | Mapping[str, Any]
    fault: NetworkFaultTable | Mapping[str, Any]
    breaker: Literal["open", "closed"]
    pcc: str
    nodes: Sequence[NetworkNodesTable | Mapping[str, Any]]
    branches: Sequence[NetworkBranchesTable | Mapping[str, Any]]
    shunts: Sequence[NetworkShuntsTable | Mapping[str, Any]]
    loads: Sequence[NetworkLoadsTable | Mapping[str, Any]]
    sources: Sequence[NetworkSourcesTable | Mapping[str, Any]]
    units: Sequence[NetworkUnitsTable | Mapping[str, Any]]
    inverters: Sequence[NetworkInvertersTable | Mapping[str, Any]]

class NetworkLoadTable(TypedDict, total=False):
    """The fields of [network.load]."""

    P: Quantity
    P_pu: Quantity
    Q: Quantity
    Q_pu: Quantity
    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity
    series: NetworkLoadSeriesTable | Mapping[str, Any]

class NetworkLoadSeriesTable(TypedDict, total=False):
    """The fields of [network.load.series]."""

    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity

class NetworkFaultTable(TypedDict, total=False):
    """The fields of [network.fault]."""

    kind: Literal["three_phase", "phase_to_phase"]
    at: Quantity
    R: Quantity
    R_pu: Quantity
    phases: Literal["ab", "bc", "ca"]

class NetworkNodesTable(TypedDict, total=False):
    """The fields of [network.nodes]."""

    name: str

NetworkBranchesTable = TypedDict("NetworkBranchesTable", {"name": str, "from": str, "to": str, "R": Quantity, "R_pu": Quantity, "L": Quantity, "X_pu": Quantity, "C": Quantity, "B_pu": Quantity, "S_rated": Quantity, "breaker": Literal["open", "closed"]}, total=False)
"""The fields of [network.branches]."""

class NetworkShuntsTable(TypedDict, total=False):
    """The fields of [network.shunts]."""

    name: str
    node: str
    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity
    breaker: Literal["open", "closed"]

class NetworkLoadsTable(TypedDict, total=False):
    """The fields of [network.loads]."""

    name: str
    node: str
    kind: Literal["impedance", "constant_power"]
    P: Quantity
    P_pu: Quantity
    Q: Quantity
    Q_pu: Quantity
    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity
    series: NetworkLoadsSeriesTable | Mapping[str, Any]
    S_rated: Quantity
    pll_bandwidth: Quantity
    pll_damping: Quantity
    current_bandwidth: Quantity
    feedforward_time: Quantity
    voltage_filter: Quantity
    breaker: Literal["open", "closed"]

class NetworkLoadsSeriesTable(TypedDict, total=False):
    """The fields of [network.loads.series]."""

    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity

class NetworkSourcesTable(TypedDict, total=False):
    """The fields of [network.sources]."""

    name: str
    node: str
    V_pu: Quantity
    phase: Quantity
    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_pu: Quantity
    breaker: Literal["open", "closed"]

class NetworkUnitsTable(TypedDict, total=False):
    """The fields of [network.units]."""

    name: str
    node: str
    case: str | Path
    reactance: Quantity
    resistance: Quantity
    P_ref: Quantity
    Q_ref: Quantity
    offset: Quantity
    pair: int
    dc: Mapping[str, Any]
    breaker: Literal["open", "closed"]

class NetworkInvertersTable(TypedDict, total=False):
    """The fields of [network.inverters]."""

    name: str
    node: str
    kind: Literal["grid_following"] | str
    S_rated: Quantity
    P_ref: Quantity
    Q_ref: Quantity
    reactance: Quantity
    resistance: Quantity
    f_s: Quantity
    delay_samples: int
    offset: Quantity
    L_1_pu: Quantity
    R_1_pu: Quantity
    C_pu: Quantity
    R_c_pu: Quantity
    L_2_pu: Quantity
    R_2_pu: Quantity
    pll_bandwidth: Quantity
    pll_damping: Quantity
    current_bandwidth: Quantity
    feedforward_time: Quantity
    keeps: Literal["power", "current"]
    voltage_filter: Quantity
    current_limit_pu: Quantity
    breaker: Literal["open", "closed"]

class PlantTable(TypedDict, total=False):
    """The fields of [plant]."""

    units: int | Sequence[int]
    reactance: Quantity
    resistance: Quantity
    sampling: Literal["together", "spread"]
    estimators: Literal["own", "common"]

class PowerLoopsTable(TypedDict, total=False):
    """The fields of [power_loops]."""

    tau_P: Quantity
    tau_Q: Quantity
    power_filter: Literal["low_pass", "notch"]
    notch_damping: Quantity
    structure: Literal["published", "decoupled", "angle_damped", "fast_voltage"] | str
    settling_time: Quantity
    damping_ratio: Quantity
    droop_ratio: Quantity
    P_design: Quantity
    Q_design: Quantity
    k_1: Quantity
    d_1: Quantity
    k_2: Quantity
    P_droop: Quantity
    Q_droop: Quantity
    share_P: Quantity
    share_Q: Quantity
    operating_point: Literal["design", "reference"]

class SimulationTable(TypedDict, total=False):
    """The fields of [simulation]."""

    duration: Quantity
    bridge: Literal["averaged", "pwm"]
    start: Literal["steady_state", "cold"]
    log_interval: Quantity
    csv_interval: Quantity
    P_ref: Quantity
    Q_ref: Quantity
    reference_limit_pu: Quantity
    survival: bool
    survival_settling_time: Quantity
    strict: bool

class ControllersTable(TypedDict, total=False):
    """The fields of [controllers]."""

    name: str
    kind: Literal["fixed", "scheduled"]
    structure: Literal["published", "decoupled", "angle_damped", "fast_voltage"] | str
    settling_time: Quantity
    damping_ratio: Quantity
    droop_ratio: Quantity
    P_design: Quantity
    Q_design: Quantity
    k_1: Quantity
    d_1: Quantity
    k_2: Quantity
    P_droop: Quantity
    Q_droop: Quantity
    share_P: Quantity
    share_Q: Quantity
    operating_point: Literal["design", "reference"]
    gains: ControllersGainsTable | Mapping[str, Any]
    design_grid: ControllersDesignGridTable | Mapping[str, Any]
    update_period: Quantity
    schedule: Literal["closed_form", "table"]
    table: str | Path
    estimate: Literal["truth", "constant", "two_windows", "rls", "kalman", "injection", "prbs", "field", "field_network", "neural"] | str
    knowledge: ControllersKnowledgeTable | Mapping[str, Any]
    current_limiter: Literal["none", "circular", "threshold_impedance", "saturation", "hybrid", "projection", "balanced_power"] | str
    current_limit_pu: Quantity
    limiter: Mapping[str, Any]

class ControllersGainsTable(TypedDict, total=False):
    """The fields of [controllers.gains]."""

    K_ip: Quantity
    D_p: Quantity
    K_iq: Quantity
    D_q: Quantity
    K_pq: Quantity
    K_qp: Quantity
    k_P: Quantity
    k_Q: Quantity

class ControllersDesignGridTable(TypedDict, total=False):
    """The fields of [controllers.design_grid]."""

    scr_basis: Literal["impedance", "reactance"] | str
    scr: Quantity
    x_over_r: Quantity
    R_g: Quantity
    L_g: Quantity

class ControllersKnowledgeTable(TypedDict, total=False):
    """The fields of [controllers.knowledge]."""

    error_R: Quantity
    error_X: Quantity
    silent: Quantity

class EventsTable(TypedDict, total=False):
    """The fields of [events]."""

    time: Quantity
    name: str
    element: str
    grid: EventsGridTable | Mapping[str, Any]
    V_g_pu: Quantity
    f_g: Quantity
    phase_jump: Quantity
    dc_power: Quantity
    dc_charge: Quantity
    irradiance: Quantity
    over: Quantity
    components: Sequence[EventsComponentsTable | Mapping[str, Any]]
    sag: EventsSagTable | Mapping[str, Any] | Literal["none"]
    load: EventsLoadTable | Mapping[str, Any] | Literal["none"]
    fault: EventsFaultTable | Mapping[str, Any] | Literal["cleared"]
    breaker: Literal["open", "closed"]
    synchro_check: EventsSynchroCheckTable | Mapping[str, Any]
    synchronise: bool
    P_ref: Quantity
    Q_ref: Quantity
    V_ref_pu: Quantity

class EventsGridTable(TypedDict, total=False):
    """The fields of [events.grid]."""

    scr: Quantity
    x_over_r: Quantity
    R_g: Quantity
    L_g: Quantity

class EventsComponentsTable(TypedDict, total=False):
    """The fields of [events.components]."""

    order: Quantity
    amplitude_pu: Quantity
    phase: Quantity

class EventsSagTable(TypedDict, total=False):
    """The fields of [events.sag]."""

    type: Literal["A", "B", "C", "D", "E", "F", "G"]
    V_pu: Quantity
    angle: Quantity

class EventsLoadTable(TypedDict, total=False):
    """The fields of [events.load]."""

    P: Quantity
    P_pu: Quantity
    Q: Quantity
    Q_pu: Quantity
    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity
    series: EventsLoadSeriesTable | Mapping[str, Any]

class EventsLoadSeriesTable(TypedDict, total=False):
    """The fields of [events.load.series]."""

    R: Quantity
    R_pu: Quantity
    L: Quantity
    X_L_pu: Quantity
    C: Quantity
    X_C_pu: Quantity

class EventsFaultTable(TypedDict, total=False):
    """The fields of [events.fault]."""

    kind: Literal["three_phase", "phase_to_phase"]
    at: Quantity
    R: Quantity
    R_pu: Quantity
    phases: Literal["ab", "bc", "ca"]

class EventsSynchroCheckTable(TypedDict, total=False):
    """The fields of [events.synchro_check]."""

    angle: Quantity
    V_pu: Quantity
    df: Quantity
    around: Quantity

class StabilityTable(TypedDict, total=False):
    """The fields of [stability]."""

    scr: Sequence[Quantity]
    x_over_r: Sequence[Quantity]
    P: Sequence[Quantity]
    Q: Sequence[Quantity]
    errors: Sequence[Quantity]
    gates: StabilityGatesTable | Mapping[str, Any]

class StabilityGatesTable(TypedDict, total=False):
    """The fields of [stability.gates]."""

    damping_ratio: Quantity
    gain_margin_db: Quantity
    phase_margin_deg: Quantity
    M_s: Quantity
    settling_time: Quantity

class SpecificationTable(TypedDict, total=False):
    """The fields of [specification]."""

    aim: Literal["settling", "inertia"]
    settling_time: Quantity
    overshoot: Quantity
    damping_ratio: Quantity
    disk_margin: Quantity
    gain_margin_db: Quantity
    phase_margin_deg: Quantity
    H: Quantity
    H_min: Quantity
    H_max: Quantity
    differential_decay: Quantity
    bandwidth_max: Quantity
    scr_basis: Literal["impedance", "reactance"] | str
    scr: Sequence[Quantity]
    x_over_r: Sequence[Quantity]
    P: Sequence[Quantity]
    Q: Sequence[Quantity]
    error: Quantity
    error_R: Quantity
    error_X: Quantity
    f_g: Sequence[Quantity]
    V_g_pu: Sequence[Quantity]
    error_Z: Quantity

class EstimatorTable(TypedDict, total=False):
    """The fields of [estimator]."""

    recipe: str | Path
    seed: int
    hidden: int
    components: int
    starts: int
    weights: str | Path
    field_weights: str | Path
    grid_phase: bool
    v_limit_pu: Quantity
    i_limit_pu: Quantity
    probe: EstimatorProbeTable | Mapping[str, Any]

class EstimatorProbeTable(TypedDict, total=False):
    """The fields of [estimator.probe]."""

    send: bool
    sigma: Quantity
    amplitude: Quantity
    amplitude_sent: Quantity
    amplitude_burst: Quantity
    current: Quantity
    ripple: Quantity
    code: int
    pair: int
    neighbours: bool

class SurvivalTable(TypedDict, total=False):
    """The fields of [survival]."""

    random: int
    seed: int
    protection: SurvivalProtectionTable | Mapping[str, Any]

class SurvivalProtectionTable(TypedDict, total=False):
    """The fields of [survival.protection]."""

    rocof: Quantity
    rocof_window: Quantity
    V_high_pu: Quantity
    V_high_time: Quantity
    V_low_pu: Quantity
    V_low_time: Quantity

class VerificationTable(TypedDict, total=False):
    """The fields of [verification]."""

    runs: int
    confidence: Quantity
    seed: int
    with_run: int
    scr_basis: Literal["impedance", "reactance"] | str
    scr: Quantity | Sequence[Quantity]
    x_over_r: Quantity | Sequence[Quantity]
    P: Quantity | Sequence[Quantity]
    Q: Quantity | Sequence[Quantity]
    V_g_pu: Quantity | Sequence[Quantity]
    f_g: Quantity | Sequence[Quantity]
    error_R: Quantity
    error_X: Quantity
    error_Z: Quantity
    silent: Quantity | Sequence[Quantity]
    units_apart: Quantity
    more_reactance: Quantity | Sequence[Quantity]
    step: VerificationStepTable | Mapping[str, Any]
    grid: VerificationGridTable | Mapping[str, Any]
    phase: VerificationPhaseTable | Mapping[str, Any]
    sag: VerificationSagTable | Mapping[str, Any]
    ramp: VerificationRampTable | Mapping[str, Any]
    reference: VerificationReferenceTable | Mapping[str, Any]
    voltage_set_point: VerificationVoltageSetPointTable | Mapping[str, Any]
    dc_power: VerificationDcPowerTable | Mapping[str, Any]
    dc_charge: VerificationDcChargeTable | Mapping[str, Any]
    irradiance: VerificationIrradianceTable | Mapping[str, Any]
    loss: VerificationLossTable | Mapping[str, Any]

class VerificationStepTable(TypedDict, total=False):
    """The fields of [verification.step]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]

class VerificationGridTable(TypedDict, total=False):
    """The fields of [verification.grid]."""

    weight: Quantity
    phase: Quantity | Sequence[Quantity]

class VerificationPhaseTable(TypedDict, total=False):
    """The fields of [verification.phase]."""

    weight: Quantity
    jump: Quantity | Sequence[Quantity]

class VerificationSagTable(TypedDict, total=False):
    """The fields of [verification.sag]."""

    weight: Quantity
    depth: Quantity | Sequence[Quantity]
    duration: Quantity | Sequence[Quantity]
    phase: Quantity | Sequence[Quantity]

class VerificationRampTable(TypedDict, total=False):
    """The fields of [verification.ramp]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]
    rate: Quantity | Sequence[Quantity]
    hold: Quantity | Sequence[Quantity]

class VerificationReferenceTable(TypedDict, total=False):
    """The fields of [verification.reference]."""

    weight: Quantity

class VerificationVoltageSetPointTable(TypedDict, total=False):
    """The fields of [verification.voltage_set_point]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]

class VerificationDcPowerTable(TypedDict, total=False):
    """The fields of [verification.dc_power]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]

class VerificationDcChargeTable(TypedDict, total=False):
    """The fields of [verification.dc_charge]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]

class VerificationIrradianceTable(TypedDict, total=False):
    """The fields of [verification.irradiance]."""

    weight: Quantity
    size: Quantity | Sequence[Quantity]

class VerificationLossTable(TypedDict, total=False):
    """The fields of [verification.loss]."""

    weight: Quantity

class BackgroundTable(TypedDict, total=False):
    """The fields of [background]."""

    level: Literal["clean", "measured", "dirty"]
    seed: int
    phase: Quantity | Sequence[Quantity]
    frequency_offset: Quantity | Sequence[Quantity]
    voltage_factor: Quantity | Sequence[Quantity]
    frequency_wander: Quantity | Sequence[Quantity]
    frequency_deviation: Quantity | Sequence[Quantity]
    voltage_wander: Quantity | Sequence[Quantity]
    voltage_deviation: Quantity | Sequence[Quantity]
    phasor_walk: Quantity | Sequence[Quantity]
    phase_noise: Quantity | Sequence[Quantity]
    voltage_noise: Quantity | Sequence[Quantity]
    voltage_steps_per_minute: Quantity | Sequence[Quantity]
    voltage_step: Quantity | Sequence[Quantity]
    phase_jumps_per_minute: Quantity | Sequence[Quantity]
    phase_jump: Quantity | Sequence[Quantity]
    negative_sequence: Quantity | Sequence[Quantity]
    harmonic_5: Quantity | Sequence[Quantity]
    harmonic_7: Quantity | Sequence[Quantity]
    harmonic_11: Quantity | Sequence[Quantity]
    harmonic_13: Quantity | Sequence[Quantity]
    modulation: Quantity | Sequence[Quantity]
    modulation_frequency: Quantity | Sequence[Quantity]
    interharmonic: Quantity | Sequence[Quantity]
    interharmonic_frequency: Quantity | Sequence[Quantity]

class SensorsTable(TypedDict, total=False):
    """The fields of [sensors]."""

    level: Literal["ideal", "typical", "dirty"]
    seed: int
    noise: Quantity | Sequence[Quantity]
    gain_error: Quantity | Sequence[Quantity]
    offset_error: Quantity | Sequence[Quantity]
    skew: Quantity | Sequence[Quantity]
    range_pu: Quantity | Sequence[Quantity]
    bits: int
    gain_errors: Sequence[Quantity]
    offset_errors: Sequence[Quantity]

class ReplayTable(TypedDict, total=False):
    """The fields of [replay]."""

    file: str | Path
    columns: Sequence[str | int]
    sampling_rate: Quantity
    scale: Quantity
    begin: Quantity

class DcTable(TypedDict, total=False):
    """The fields of [dc]."""

    source: Literal["battery", "converter", "photovoltaic"] | str
    C: Quantity
    R_bleed: Quantity
    V_low: Quantity
    V_high: Quantity
    compensation: Literal["measured", "none"]
    control: Literal["none", "power_clamp", "voltage_droop"]
    battery: DcBatteryTable | Mapping[str, Any]
    converter: DcConverterTable | Mapping[str, Any]
    photovoltaic: DcPhotovoltaicTable | Mapping[str, Any]
    power_clamp: DcPowerClampTable | Mapping[str, Any]
    voltage_droop: DcVoltageDroopTable | Mapping[str, Any]

class DcBatteryTable(TypedDict, total=False):
    """The fields of [dc.battery]."""

    open_circuit: Sequence[Quantity]
    R_i: Quantity
    i_max: Quantity
    i_charge_max: Quantity
    capacity_Ah: Quantity
    charge: Quantity

class DcConverterTable(TypedDict, total=False):
    """The fields of [dc.converter]."""

    p_max: Quantity
    p_charge_max: Quantity
    tau: Quantity
    ramp: Quantity
    feed_forward: Quantity
    k_p: Quantity
    energy: Quantity
    charge: Quantity

class DcPhotovoltaicTable(TypedDict, total=False):
    """The fields of [dc.photovoltaic]."""

    modules: Quantity
    strings: Quantity
    irradiance: Quantity
    temperature: Quantity
    I_L: Quantity
    I_0: Quantity
    a: Quantity
    R_s: Quantity
    R_sh: Quantity
    alpha_sc: Quantity

class DcPowerClampTable(TypedDict, total=False):
    """The fields of [dc.power_clamp]."""

    hold: Quantity
    droop_time: Quantity

class DcVoltageDroopTable(TypedDict, total=False):
    """The fields of [dc.voltage_droop]."""

    share: Quantity

def load(
    source: str | Path | Mapping[str, Any],
    *,
    P_ref: Quantity = ...,
    Q_ref: Quantity = ...,
    duration: Quantity = ...,
    bridge: Literal["averaged", "pwm"] = ...,
    start: Literal["steady_state", "cold"] = ...,
    log_interval: Quantity = ...,
    base: str = ...,
    schema: int = ...,
    study: StudyTable | Mapping[str, Any] = ...,
    converter: ConverterTable | Mapping[str, Any] = ...,
    filter: FilterTable | Mapping[str, Any] = ...,
    inner_loops: InnerLoopsTable | Mapping[str, Any] = ...,
    grid: GridTable | Mapping[str, Any] = ...,
    network: NetworkTable | Mapping[str, Any] = ...,
    plant: PlantTable | Mapping[str, Any] = ...,
    power_loops: PowerLoopsTable | Mapping[str, Any] = ...,
    simulation: SimulationTable | Mapping[str, Any] = ...,
    controllers: Sequence[ControllersTable | Mapping[str, Any]] = ...,
    events: Sequence[EventsTable | Mapping[str, Any]] = ...,
    stability: StabilityTable | Mapping[str, Any] = ...,
    specification: SpecificationTable | Mapping[str, Any] = ...,
    estimator: EstimatorTable | Mapping[str, Any] = ...,
    survival: SurvivalTable | Mapping[str, Any] = ...,
    verification: VerificationTable | Mapping[str, Any] = ...,
    background: BackgroundTable | Mapping[str, Any] = ...,
    sensors: SensorsTable | Mapping[str, Any] = ...,
    replay: ReplayTable | Mapping[str, Any] = ...,
    dc: DcTable | Mapping[str, Any] = ...,
) -> Study:
    """The study of a file, of a packaged case (``"case:NAME"``) or of a document (a mapping, as TOML would give it).

    ``changes`` are the sections of a study file: ``grid=vd.grid(scr=3, x_over_r=4)``, ``controllers=[...]``,
    ``events=[...]``, ``specification={...}``. ``P_ref``, ``Q_ref``, ``duration``, ``bridge``, ``start`` and
    ``log_interval`` of the simulation may be given without their section. Values are in SI units or texts with a unit
    ("4 kW"). Required fields that are left out get a default: one scheduled controller, references of zero, and a run
    that ends three seconds after the last event.

    If the source does not give the inner loops, they are designed. Those of a study file are kept beside it for the
    next time. Raises StudyError with every fault at once.

    Parameters:
        P_ref: Set point at t = 0 (±`reference_limit_pu` S_rated in W; required).
        Q_ref: Set point at t = 0 (±`reference_limit_pu` S_rated in var; required).
        duration: Simulated time (0.001 to 36000 in s; required).
        bridge: The bridge produces its reference exactly, or it switches (default `averaged`).
        start: At rest in the first operating point, or with everything at zero (default `steady_state`).
        log_interval: Spacing of the rows that are written and drawn; a multiple of T_s, at most 5 million in
        all. Figures and verdicts come [from every sample](definitions.md#figures-of-a-run) instead (0 to 1 in
        s; default multiple of T_s nearest to 200 µs).
        base: Another document underneath this one (default none).
        schema: Version of this format (1 to 1; default 1).
        study: Identity (default none).
        converter: Ratings, bridge, sampling (required).
        filter: LC or LCL filter (required).
        inner_loops: Voltage and current loop (default designed).
        grid: Grid at t = 0 (required).
        network: Load, fault and breaker at t = 0, and the network of a plant (default plain).
        plant: Several equal converters at one node (default one converter).
        power_loops: Structure and design target of the power loops (default all defaults).
        simulation: One EMT run (required).
        controllers: What to simulate and compare (at least one; required).
        events: What changes, and when (default none).
        stability: Axes of the margin maps, and gates (default the defaults below).
        specification: What a designed gain table has to keep, and over what (default none).
        estimator: The network that estimates the grid for controllers with `estimate = "neural"` (default
        none).
        survival: Random disturbances of a survival measurement (default the defaults below).
        verification: Random cases with which promises are tested (default the defaults below).
        background: What the voltage of a real grid does besides the events (default none).
        sensors: Noise, bits and errors between the circuit and the controller (default ideal).
        replay: A recorded voltage as the source (default none).
        dc: The capacitor of the dc link and what feeds it (default ideal).
    """
    ...

def grid(
    *,
    scr_basis: Literal["impedance", "reactance"] | str = ...,
    scr: Quantity = ...,
    x_over_r: Quantity = ...,
    R_g: Quantity = ...,
    L_g: Quantity = ...,
    V_g_pu: Quantity = ...,
    f_g: Quantity = ...,
    components: Sequence[GridComponentsTable | Mapping[str, Any]] = ...,
) -> dict[str, Any]:
    """A grid with ``scr`` and ``x_over_r``, or with ``R_g`` (Ω) and ``L_g`` (H).

    In an event, ``scr`` or ``x_over_r`` alone may be enough.

    Parameters:
        scr_basis: What every `scr` in the file is taken on (:eq:`scr`) (default `impedance`).
        scr: Short-circuit ratio at the PCC on S_rated (0.05 to 1e4; required, or `R_g`, `L_g`).
        x_over_r: X_g/R_g at nominal frequency (0.001 to 1e4; required, or `R_g`, `L_g`).
        R_g: Resistance (0 to 20 Z_base in ohm; required, or `scr`, `x_over_r`).
        L_g: Inductance (1e-4 to 20 times Z_base/ω_n in H; required, or `scr`, `x_over_r`).
        V_g_pu: Source voltage, pu of rated (0.1 to 2; default 1).
        f_g: Source frequency (0.8 to 1.2 times f_n in Hz; default `f_n`).
        components: Negative sequence and harmonics of the source (default none).
    """
    ...

def event(
    time: Quantity,
    *,
    name: str = ...,
    element: str = ...,
    grid: EventsGridTable | Mapping[str, Any] = ...,
    V_g_pu: Quantity = ...,
    f_g: Quantity = ...,
    phase_jump: Quantity = ...,
    dc_power: Quantity = ...,
    dc_charge: Quantity = ...,
    irradiance: Quantity = ...,
    over: Quantity = ...,
    components: Sequence[EventsComponentsTable | Mapping[str, Any]] = ...,
    sag: EventsSagTable | Mapping[str, Any] | Literal["none"] = ...,
    load: EventsLoadTable | Mapping[str, Any] | Literal["none"] = ...,
    fault: EventsFaultTable | Mapping[str, Any] | Literal["cleared"] = ...,
    breaker: Literal["open", "closed"] = ...,
    synchro_check: EventsSynchroCheckTable | Mapping[str, Any] = ...,
    synchronise: bool = ...,
    P_ref: Quantity = ...,
    Q_ref: Quantity = ...,
    V_ref_pu: Quantity = ...,
) -> dict[str, Any]:
    """An event at a time in s, or at a text such as "2 s".

    The fields are those of [[events]] in a study file.

    Parameters:
        time: Instant (0 to `duration` in s; required).
        name: Label in reports (not empty; default a description of the change).
        element: Of a plant, by its name, what it changes: a unit (set points, `breaker`, dc source), an
        inverter (set points, `breaker`), a branch, shunt, load or source (`breaker`), or a node (`fault`)
        (default the grid and all units).
        grid: New grid impedance (default unchanged).
        V_g_pu: source voltage, pu of rated (0 to 2; default unchanged).
        f_g: source frequency (0.8 to 1.2 times f_n in Hz; default unchanged).
        phase_jump: jump of the source's phase, positive: ahead. A component of order n jumps by n times as
        much: the whole waveform moves (−π to π in rad; default 0).
        dc_power: share of the source of the dc link that is left ([dc side](theory/dc-side.md#events)) (0 to
        1; default unchanged).
        dc_charge: state of charge of this source ([dc side](theory/dc-side.md#events)) (0 to 1; default
        unchanged).
        irradiance: irradiance on its array ([dc side](theory/dc-side.md#events)) (1 to 2000 in W/m^2; default
        unchanged).
        over: Ramps `V_g_pu` and `f_g` linearly over this time (0 to `duration` in s; default 0).
        components: The source's negative sequence and harmonics from now on, in place of all earlier ones;
        `[]`: none (default unchanged).
        sag: An unbalanced or balanced voltage sag from now on; `"none"` ends it (default unchanged).
        load: The load at the PCC from now on; `"none"`: no load (default unchanged).
        fault: The short circuit from now on; `"cleared"` ends it, phase by phase at the next zeros of its
        currents ([theory](theory/networks.md#clearing-at-zeros)) (default unchanged).
        breaker: The breaker between the PCC and the grid (default unchanged).
        synchro_check: With `breaker = "closed"`: the breaker waits until both sides are near each other; in a
        plant, that of a unit (default at once).
        synchronise: With `breaker = "closed"`: the converter sets itself to the grid behind the breaker,
        which closes when it has been in step for 0.2 s (default false).
        P_ref: set point (±`reference_limit_pu` S_rated in W; default unchanged).
        Q_ref: set point (±`reference_limit_pu` S_rated in var; default unchanged).
        V_ref_pu: set point of the voltage in the Q–V droop, pu of rated. A controller without this droop does
        not answer (`V_min_pu` to `V_max_pu`; default unchanged).
    """
    ...

def controller(
    name: str,
    kind: Literal["fixed", "scheduled"] = 'scheduled',
    *,
    structure: Literal["published", "decoupled", "angle_damped", "fast_voltage"] | str = ...,
    settling_time: Quantity = ...,
    damping_ratio: Quantity = ...,
    droop_ratio: Quantity = ...,
    P_design: Quantity = ...,
    Q_design: Quantity = ...,
    k_1: Quantity = ...,
    d_1: Quantity = ...,
    k_2: Quantity = ...,
    P_droop: Quantity = ...,
    Q_droop: Quantity = ...,
    share_P: Quantity = ...,
    share_Q: Quantity = ...,
    operating_point: Literal["design", "reference"] = ...,
    gains: ControllersGainsTable | Mapping[str, Any] = ...,
    design_grid: ControllersDesignGridTable | Mapping[str, Any] = ...,
    update_period: Quantity = ...,
    schedule: Literal["closed_form", "table"] = ...,
    table: str | Path = ...,
    estimate: Literal["truth", "constant", "two_windows", "rls", "kalman", "injection", "prbs", "field", "field_network", "neural"] | str = ...,
    knowledge: ControllersKnowledgeTable | Mapping[str, Any] = ...,
    current_limiter: Literal["none", "circular", "threshold_impedance", "saturation", "hybrid", "projection", "balanced_power"] | str = ...,
    current_limit_pu: Quantity = ...,
    limiter: Mapping[str, Any] = ...,
) -> dict[str, Any]:
    """A controller, ``scheduled`` or ``fixed``, with the fields of a study file's [[controllers]].

    Parameters:
        name: Becomes a file name (letters, digits, `-` `_` `.`, a name of a file; at most 100 bytes; unique,
        also without regard to case; required).
        kind: Gains that never change, or gains that follow the grid impedance (required).
        structure: Control law (default of `[power_loops]`).
        settling_time: T_set in ω_n = 4/(ξ T_set). At ξ = 1 the loop takes 1.46 times as long
        (:eq:`critical-settling`) (0.01 to 1000 in s; default of `[power_loops]`).
        damping_ratio: ξ of the P loop (0.05 to 20; default of `[power_loops]`).
        droop_ratio: q in D_q = q·D (0 to 10; default of `[power_loops]`).
        P_design: Active power of the operating point at which A and D are taken (±2 S_rated in W; default of
        `[power_loops]`).
        Q_design: Reactive power of this operating point (±2 S_rated in var; default of `[power_loops]`).
        k_1: Pole placement of δ: s² + d_1 s + k_1, for T_d (:eq:`placed-poles`) (0.001 to 1e6 in 1/s²;
        default of `[power_loops]`, scaled: 24.21/T_d²).
        d_1: Pole placement of δ: s² + d_1 s + k_1 (0.001 to 1e4 in 1/s; default of `[power_loops]`, scaled:
        9.053/T_d).
        k_2: Pole placement of V: s + k_2 (0.001 to 1e4 in 1/s; default of `[power_loops]`, scaled:
        3.912/T_d).
        P_droop: Frequency deviation, pu, that rated power answers; 0: none. `decoupled` has the droop that
        its damping needs (0 to 1; default of `[power_loops]`).
        Q_droop: Voltage deviation, pu, that rated power answers; 0: none (0 to 1; default of
        `[power_loops]`).
        share_P: Share of the coupling B taken out of the P row (0 to 1; default of `[power_loops]`).
        share_Q: Share of the coupling C taken out of the Q row (0 to 1; default of `[power_loops]`).
        operating_point: Where a closed form takes the Jacobian: at `P_design`, `Q_design`, or at the measured
        P, Q and V, which follow the references. A table always takes the measured ones (default of
        `[power_loops]`).
        gains: The gains themselves: the four of the published structure, or all eight (`fixed` only; default
        none).
        design_grid: Grid for which the fixed gains are designed; in a plant, as the unit sees it (`fixed`
        only; not with `gains`; default the grid at t = 0).
        update_period: `scheduled` only: time between updates, a multiple of T_s (T_s to `duration` in s;
        default 0.02, as near as T_s allows; with an estimate the window).
        schedule: `scheduled` only: where the gains come from; `table` needs a `[specification]` to design one
        to, or `table` (default `closed_form`).
        table: File of a gain table to use instead of designing one (a file; default none).
        estimate: `scheduled` only: what it knows of the grid, the truth or an [estimate](#estimates);
        `neural` needs an `[estimator]` (default `truth`).
        knowledge: `scheduled` with `truth` only: [how wrong and how late](#controllersknowledge) it knows the
        grid (default the grid exactly and at once).
        current_limiter: How this controller limits its current; `none`: it does not (default of
        `[converter]`).
        current_limit_pu: Limit of this controller's current reference, pu of the rated peak; not with `none`
        (0.5 to 20; default of `[converter]`).
        limiter: Parameters of this controller's limiter: the fields of
        [`[converter.limiter]`](#converterlimiter) (default of `[converter]` with the same limiter).
    """
    ...

def arguments() -> dict[str, tuple[Field, ...]]: ...
