"""Points of SunSpec's models, and why this project has no value for one.

The names of models 702, 704 and 711 to 713 are those of the published models (tests/export/test_sunspec.py), those of
64416 of the proposal.
"""

from __future__ import annotations

from typing import NamedTuple


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
