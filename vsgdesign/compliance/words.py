"""A test's grid and its events in words, for rows and for study files."""

from __future__ import annotations

from vsgdesign.compliance.network_in_si import admittance_pu
from vsgdesign.compliance.suite import SuiteEvent, SuiteTest
from vsgdesign.parameters.network import THREE_PHASE, Fault, Load


def network_in_words(test: SuiteTest) -> str:
    """The grid and the operating point of a test: ``SCR 3, X/R 10, P 0.5 pu``."""
    parts = [f"SCR {test.scr:.4g}", f"X/R {test.x_over_r:.4g}", f"P {test.P_pu:.4g} pu"]
    if test.Q_pu:
        parts.append(f"Q {test.Q_pu:.4g} pu")
    if test.V_g_pu != 1.0:
        parts.append(f"V_g {test.V_g_pu:.4g} pu")
    if test.load is not None:
        parts.append(load_in_words(test.load))
    return ", ".join(parts)


def events_in_words(test: SuiteTest) -> str:
    """All events of a test with their instants."""
    return "; ".join(f"{event_in_words(event)} at {event.t_s:.4g} s" for event in test.events)


def event_in_words(event: SuiteEvent) -> str:
    """What changes: ``phase +60°``, ``V_g 0.2 pu``."""
    ramp = f" over {event.over_s:.4g} s" if event.over_s > 0.0 else ""
    parts = []
    if event.scr is not None:
        parts.append(f"SCR {event.scr:.4g}, X/R {event.x_over_r:.4g}")
    if event.V_g_pu is not None:
        parts.append(f"V_g {event.V_g_pu:.4g} pu{ramp}")
    if event.sag is not None:
        parts.append(f"sag {event.sag.kind} to {event.sag.V_pu:.4g} pu")
    if event.df_hz is not None:
        parts.append(f"{event.df_hz:+.4g} Hz{ramp}")
    if event.phase_deg != 0.0:
        parts.append(f"phase {event.phase_deg:+.4g}°")
    if event.P_pu is not None:
        parts.append(f"P_ref {event.P_pu:.4g} pu")
    if event.Q_pu is not None:
        parts.append(f"Q_ref {event.Q_pu:.4g} pu")
    if event.fault is not None:
        parts.append(fault_in_words(event.fault))
    if event.fault_cleared:
        parts.append("fault cleared")
    if event.load is not None:
        parts.append(load_in_words(event.load))
    if event.load_off:
        parts.append("load off")
    if event.connected is not None:
        parts.append("breaker closes" if event.connected else "breaker opens")
    return ", ".join(parts) or "nothing"


def fault_in_words(fault: Fault) -> str:
    """``three-phase fault at the PCC``."""
    kind = "three-phase fault" if fault.kind == THREE_PHASE else f"fault between phases {' and '.join(fault.phases)}"
    where = "at the PCC" if fault.at == 0.0 else f"behind {100.0 * fault.at:.3g} % of the grid's impedance"
    through = f" through {fault.R:.3g} pu" if fault.R else ""
    return f"{kind} {where}{through}"


def load_in_words(load: Load) -> str:
    """``load 0.5 + j0.1 pu``: its power at the nominal voltage."""
    S = admittance_pu(load).conjugate()
    reactive = f" {'+' if S.imag > 0.0 else '−'} j{abs(S.imag):.3g}" if abs(S.imag) > 1e-6 else ""
    return f"load {S.real:.3g}{reactive} pu"
