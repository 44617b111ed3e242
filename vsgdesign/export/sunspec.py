"""A controller of a study in the words of SunSpec's models: which of its values belongs to which point.

Models 702, 704 and 711 to 713 are published, and the names of their points are those of the published models
(tests/export/test_sunspec.py). Model 64416 for grid-forming control is a proposal (pull request 277 of
github.com/sunspec/models, July 2026), and so is this map. A point without a value of ours says why.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.files import json_text
from vsgdesign.equations.controller import IN_STEP
from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.frames import base_impedance, peak_to_rms, phase_to_ll, rated_current_rms
from vsgdesign.equations.structures import effective_inertia, steady_droops
from vsgdesign.export.port_records import FIXED, INPUT, TUNABLE
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of
from vsgdesign.export.wrapping import Builder, Exported, check_target, wrapped, write_wrapper


class Model(NamedTuple):
    """A model of SunSpec."""

    name: str
    published: bool
    points: tuple[str, ...]
    """All points in order; one in a group behind the name of the group."""


_POINTS = {
    702: """
        ID L WMaxRtg WOvrExtRtg WOvrExtRtgPF WUndExtRtg WUndExtRtgPF VAMaxRtg VarMaxInjRtg VarMaxAbsRtg
        WChaRteMaxRtg WDisChaRteMaxRtg VAChaRteMaxRtg VADisChaRteMaxRtg VNomRtg VMaxRtg VMinRtg AMaxRtg
        PFOvrExtRtg PFUndExtRtg ReactSusceptRtg NorOpCatRtg AbnOpCatRtg CtrlModes IntIslandCatRtg WMax
        WMaxOvrExt WOvrExtPF WMaxUndExt WUndExtPF VAMax VarMaxInj VarMaxAbs WChaRteMax WDisChaRteMax
        VAChaRteMax VADisChaRteMax VNom VMax VMin AMax PFOvrExt PFUndExt IntIslandCat W_SF PF_SF VA_SF Var_SF
        V_SF A_SF S_SF
    """,
    704: """
        ID L PFWInjEna PFWInjEnaRvrt PFWInjRvrtTms PFWInjRvrtRem PFWAbsEna PFWAbsEnaRvrt PFWAbsRvrtTms
        PFWAbsRvrtRem WMaxLimPctEna WMaxLimPct WMaxLimPctRvrt WMaxLimPctEnaRvrt WMaxLimPctRvrtTms
        WMaxLimPctRvrtRem WSetEna WSetMod WSet WSetRvrt WSetPct WSetPctRvrt WSetEnaRvrt WSetRvrtTms
        WSetRvrtRem VarSetEna VarSetMod VarSetPri VarSet VarSetRvrt VarSetPct VarSetPctRvrt VarSetEnaRvrt
        VarSetRvrtTms VarSetRvrtRem WRmp WRmpRef VarRmp AntiIslEna PF_SF WMaxLimPct_SF WSet_SF WSetPct_SF
        VarSet_SF VarSetPct_SF PFWInj.PF PFWInj.Ext PFWInjRvrt.PF PFWInjRvrt.Ext PFWAbs.PF PFWAbs.Ext
        PFWAbsRvrt.PF PFWAbsRvrt.Ext
    """,
    711: """
        ID L Ena AdptCtlReq AdptCtlRslt NCtl RvrtTms RvrtRem RvrtCtl Db_SF K_SF RspTms_SF Ctl.DbOf Ctl.DbUf
        Ctl.KOf Ctl.KUf Ctl.RspTms Ctl.PMin Ctl.ReadOnly
    """,
    712: """
        ID L Ena AdptCrvReq AdptCrvRslt NPt NCrv RvrtTms RvrtRem RvrtCrv W_SF DeptRef_SF Crv.ActPt Crv.DeptRef
        Crv.Pri Crv.ReadOnly Crv.Pt.W Crv.Pt.Var
    """,
    713: """
        ID L WHRtg WHAvail SoC SoH Sta WH_SF Pct_SF
    """,
    64416: """
        ID L GridMd GridSt CtrlAlg DroopP DroopQ InertiaH Damping DampTms VirtualX VirtualR FilterTms WSet
        VarSet VRef HzRef PRmpUp PRmpDn VRmp HzRmp IMaxCont IMaxTrans IMaxDur LimMode IInst ROCOFLim MaxAng
        ThetaInv EInv ROCOF PInert PDroop PRef PSync PDamper AngStroke SyncStat ModeDemoted BSEna BSVRamp
        BSHzRamp BSDwell AIOvr SyncEna SyncVTol SyncHzTol SyncAngTol UnitRole UnitID LeaderHzGain V_SF A_SF
        Hz_SF W_SF Var_SF Pct_SF WRmp_SF VRmp_SF HzRmp_SF
    """,
}

_NAMES = {
    702: "DERCapacity",
    704: "DERCtlAC",
    711: "DERFreqDroop",
    712: "DERWattVar",
    713: "DERStorageCapacity",
    64416: "DERGridForming",
}

PROPOSED = 64416
"""The only one that is not published."""

MODELS = {number: Model(_NAMES[number], number != PROPOSED, tuple(text.split())) for number, text in _POINTS.items()}
"""The models by their numbers."""

_WITHOUT: dict[int, tuple[tuple[str, str], ...]] = {
    702: (
        ("the device's Modbus server sets it", "ID L W_SF PF_SF VA_SF Var_SF V_SF A_SF S_SF"),
        (
            "the rating is one of apparent power, at any power factor",
            """
            WOvrExtRtg WOvrExtRtgPF WUndExtRtg WUndExtRtgPF PFOvrExtRtg PFUndExtRtg WMaxOvrExt WOvrExtPF
            WMaxUndExt WUndExtPF PFOvrExt PFUndExt
            """,
        ),
        (
            "the controller knows nothing of the dc side and its storage",
            """
            WChaRteMaxRtg WDisChaRteMaxRtg VAChaRteMaxRtg VADisChaRteMaxRtg WChaRteMax WDisChaRteMax
            VAChaRteMax VADisChaRteMax
            """,
        ),
        ("no range of the voltage is stated for the device", "VMaxRtg VMinRtg VMax VMin"),
        (
            "it is declared for a device, and not computed",
            "ReactSusceptRtg NorOpCatRtg AbnOpCatRtg CtrlModes IntIslandCatRtg IntIslandCat",
        ),
        ("a setting below the rating belongs to the device", "WMax VAMax VarMaxInj VarMaxAbs VNom AMax"),
    ),
    704: (
        ("the device's Modbus server sets it", "ID L PF_SF WMaxLimPct_SF WSet_SF WSetPct_SF VarSet_SF VarSetPct_SF"),
        ("Q is set, and not the power factor", "PFWInjEna PFWAbsEna PFWInj.PF PFWInj.Ext PFWAbs.PF PFWAbs.Ext"),
        (
            "no set point reverts by itself",
            """
            PFWInjEnaRvrt PFWInjRvrtTms PFWInjRvrtRem PFWAbsEnaRvrt PFWAbsRvrtTms PFWAbsRvrtRem
            WMaxLimPctRvrt WMaxLimPctEnaRvrt WMaxLimPctRvrtTms WMaxLimPctRvrtRem WSetRvrt WSetPctRvrt
            WSetEnaRvrt WSetRvrtTms WSetRvrtRem VarSetRvrt VarSetPctRvrt VarSetEnaRvrt VarSetRvrtTms
            VarSetRvrtRem PFWInjRvrt.PF PFWInjRvrt.Ext PFWAbsRvrt.PF PFWAbsRvrt.Ext
            """,
        ),
        ("there is no limit of the power but that of the current", "WMaxLimPctEna WMaxLimPct"),
        ("neither has priority: the limiter shortens the current", "VarSetPri"),
        ("set points act at once, and the power follows as the gains say", "WRmp WRmpRef VarRmp"),
        ("a grid-forming converter goes on in an island", "AntiIslEna"),
    ),
    711: (
        ("the device's Modbus server sets it", "ID L AdptCtlReq AdptCtlRslt Db_SF K_SF RspTms_SF Ctl.ReadOnly"),
        ("the controller has no droop of P", "Ena NCtl Ctl.DbOf Ctl.DbUf Ctl.KOf Ctl.KUf"),
        ("no set point reverts by itself", "RvrtTms RvrtRem RvrtCtl"),
        ("the time depends on the grid: see vsgdesign margins", "Ctl.RspTms"),
        ("there is no limit of the power but that of the current", "Ctl.PMin"),
    ),
    712: (("Q follows the voltage, and not P", "*"),),
    713: (("the controller knows nothing of the dc side and its storage", "*"),),
    64416: (
        ("the device's Modbus server sets it", "L V_SF A_SF Hz_SF W_SF Var_SF Pct_SF WRmp_SF VRmp_SF HzRmp_SF"),
        ("modes and protection are the device's", "GridSt IInst ROCOFLim MaxAng ModeDemoted"),
        ("the controller has no such droop", "DroopP DroopQ"),
        ("a ratio depends on the grid: see vsgdesign margins", "Damping"),
        ("the damping acts at once", "DampTms"),
        ("the power has no low-pass, or a notch in front of it", "FilterTms"),
        ("set points act at once", "PRmpUp PRmpDn VRmp HzRmp"),
        ("the study has no current limit", "IMaxCont"),
        ("there is one limit, which holds for any time", "IMaxTrans IMaxDur"),
        ("none of these is the limiter of this project", "LimMode"),
        ("the converter does not know the angle of the grid", "ThetaInv AngStroke"),
        ("the controller does not divide its power", "ROCOF PInert PDroop PRef PSync PDamper"),
        ("the controller has no black start and no detection of islands", "BSEna BSVRamp BSHzRamp BSDwell AIOvr"),
        ("one window for the difference of both voltages decides: see SyncVTol", "SyncEna SyncHzTol SyncAngTol"),
        ("units know nothing of each other", "UnitRole UnitID LeaderHzGain"),
    ),
}

WITHOUT = {
    number: {name: why for why, names in groups for name in (MODELS[number].points if names == "*" else names.split())}
    for number, groups in _WITHOUT.items()
}
"""Why there is no value for a point, by model and name."""


PROPOSAL = "The map to SunSpec's models is a proposal, and so is model 64416 itself (sunspec/models, pull request 277)."

FILE = "sunspec.json"


class Value(NamedTuple):
    """What a point is given: a value in the unit of the model, or an output of the controller while it runs."""

    unit: str
    ours: str
    """The quantity of this project."""
    value: float | None = None
    port: str = ""
    """Name of the output of the exported controller."""
    note: str = ""


def sunspec_map(unit: Unit) -> dict[str, Any]:
    """The map in JSON's types."""
    values = _values(unit)
    models = {}
    for number, model in MODELS.items():
        points: dict[str, Any] = {}
        for name in model.points:
            found = values.get(number, {}).get(name)
            points[name] = {"no counterpart": WITHOUT[number][name]} if found is None else _entry(found)
        models[str(number)] = {"name": model.name, "published": model.published, "points": points}
    return {
        "proposal": PROPOSAL,
        "signs": "P and Q are positive into the grid.",
        "gains": _of_which_gains(unit),
        "models": models,
        "without a point": list(_left_over(unit)),
    }


def _entry(found: Value) -> dict[str, Any]:
    told: dict[str, Any] = {"unit": found.unit, "ours": found.ours}
    told |= {"port": found.port} if found.port else {"value": found.value}
    return told | ({"note": found.note} if found.note else {})


def _values(unit: Unit) -> dict[int, dict[str, Value]]:
    S, V, omega = unit.S_rated, unit.V_rated_rms, unit.omega_n
    refs, gains, settings = unit.references, unit.gains, unit.constants.controller_settings
    droop_P, droop_Q = (float(one) for one in steady_droops(gains, S, omega, V))
    powers = {
        "WMaxRtg": Value("W", "S_rated", S, note="at unity power factor"),
        "VAMaxRtg": Value("VA", "S_rated", S),
        "VarMaxInjRtg": Value("Var", "S_rated", S, note="without active power"),
        "VarMaxAbsRtg": Value("Var", "S_rated", S, note="without active power"),
        "VNomRtg": Value("V", "V_rated_ll_rms", float(phase_to_ll(V)), note="line to line"),
        "AMaxRtg": Value("A", "S_rated / (3 V_rated_rms)", float(rated_current_rms(S, V)), note="rms"),
    }
    found = {
        702: powers,
        704: {
            "WSetEna": Value("", "the power loops", 1, note="ENABLED"),
            "WSetMod": Value("", "the power loops", 1, note="WATTS"),
            "WSet": Value("W", "P_ref", refs.P_ref),
            "WSetPct": Value("Pct", "P_ref / S_rated", 100.0 * refs.P_ref / S),
            "VarSetEna": Value("", "the power loops", 1, note="ENABLED"),
            "VarSetMod": Value("", "the power loops", 4, note="VARS"),
            "VarSet": Value("Var", "Q_ref", refs.Q_ref, note="where the voltage is V_ref: see DroopQ"),
            "VarSetPct": Value("Pct", "Q_ref / S_rated", 100.0 * refs.Q_ref / S),
        },
        711: {},
        712: {},
        713: {},
        64416: {
            "ID": Value("", "the model", 64416),
            "GridMd": Value("", "the power loops", 2, note='"Grid-Forming Mode" (OFF_GRID), also on a grid'),
            "CtrlAlg": Value("", "the power loops", 1, note="VSM"),
            "InertiaH": Value("Sec", "H_s", float(effective_inertia(gains, S, omega))),
            "WSet": Value("W", "P_ref", refs.P_ref),
            "VarSet": Value("var", "Q_ref", refs.Q_ref),
            "VRef": Value("V", "V_n", refs.V_n, note="line to neutral, rms"),
            "HzRef": Value("Hz", "omega_0 / (2 pi)", refs.omega_0 / (2.0 * math.pi)),
            "SyncVTol": Value("pu", "in step", IN_STEP, note="length of the difference of both space vectors"),
            "EInv": Value("V", "V of the power loops", port="V_rms", note="line to neutral, rms"),
            "SyncStat": Value("", "in step", port="ready", note="1 is LOCKED"),
        },
    }
    if droop_P > 0.0:
        slope = Value("", "droop of P", droop_P, note="the frequency follows the power: the converter forms it")
        at_once = Value("Hz", "dead band", 0.0, note="there is none")
        found[711] = {
            "Ena": Value("", "the power loops", 1, note="ENABLED"),
            "NCtl": Value("", "the power loops", 1),
            "Ctl.DbOf": at_once,
            "Ctl.DbUf": at_once,
            "Ctl.KOf": slope,
            "Ctl.KUf": slope,
        }
        found[64416]["DroopP"] = Value("pu/pu", "S_rated / (D_p omega_n)", droop_P)
    if droop_Q > 0.0:
        found[64416]["DroopQ"] = Value("pu/pu", "S_rated / (D_q V_rated_rms)", droop_Q)
    inner, Z = unit.constants.inner_gains, float(base_impedance(S, V))
    for name, value, ours in (("VirtualX", inner.X_t, "X_t"), ("VirtualR", inner.R_t, "R_t")):
        note = "acts on changes of the current alone (transient impedance)"
        found[64416][name] = Value("pu", ours, float(value) / Z, note=note if value else "there is none")
    if (tau := _time_constant(settings)) is not None:
        found[64416]["FilterTms"] = Value("mSec", "tau_P", 1e3 * tau)
    if limited := _limit(unit):
        found[64416]["IMaxCont"] = Value("A", "current limit", limited, note="rms; it holds for any time")
    return found


def _time_constant(settings: ControllerSettings) -> float | None:
    """Of the low-pass of P, s; None where a notch is in front of it or there is none."""
    smoothing = float(settings.smoothing_P)
    if settings.notch_gain or not 0.0 < smoothing < 1.0:
        return None
    return -float(settings.T_s) / math.log1p(-smoothing)


def _limit(unit: Unit) -> float | None:
    """The current limit, A rms; None where the limiter never acts."""
    i_max = float(unit.constants.controller_settings.i_max_pk)
    rated = rated_current_rms(unit.S_rated, unit.V_rated_rms)
    return float(peak_to_rms(i_max)) if peak_to_rms(i_max) < 100.0 * rated else None


def _of_which_gains(unit: Unit) -> str:
    if not unit.scheduled:
        return "The gains are fixed."
    return (
        f"The gains follow the grid. Droops and inertia are those with which the controller begins, for R_g = "
        f"{unit.grid.R_g:.6g} ohm and L_g = {unit.grid.L_g:.6g} H."
    )


def _left_over(unit: Unit) -> Iterable[str]:
    """What the controller has and no point of these models says."""
    gains = unit.gains._asdict()
    yield from (f"{name} = {float(value):.6g}" for name, value in gains.items() if name not in ("D_p", "D_q") and value)
    yield "gains of the voltage and current loops"
    yield f"current limiter: {unit.origin.limiter}"
    if unit.scheduled:
        yield "schedule over R_g and L_g, with its guards and its status"
    if unit.has_field:
        yield "estimate of R_g and L_g, and its probe"
    ports, named = (
        lists_of(unit)["controller"],
        {one.ours for model in _values(unit).values() for one in model.values()},
    )
    yield from (f"{port.name}: {port.meaning}" for port in ports.of(INPUT, FIXED, TUNABLE) if port.name not in named)


def export_sunspec(
    unit: Unit, out: str | Path, *, inputs: Iterable[str | Path] = (), builder: Builder | None = None
) -> Exported:
    """Writes the map of a controller to SunSpec's models as sunspec.json into the folder ``out``.

    Raises ArtifactError for a folder with other files.
    """
    del builder  # nothing is compiled
    inputs = tuple(inputs)
    check_target("sunspec", out, inputs)
    text = json_text(sunspec_map(unit))
    return write_wrapper("sunspec", wrapped(unit, "controller"), out, {FILE: text}, inputs=inputs, said=(PROPOSAL,))
