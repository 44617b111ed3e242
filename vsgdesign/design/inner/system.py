"""A study around a converter, its filter and a set of inner gains: for the controller's constants and for the check."""

from __future__ import annotations

from vsgdesign.design.inner.grids import GridBox
from vsgdesign.equations.closed_form import EQUAL_TIMES, paced
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.structures import ANGLE_DAMPED
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.grid import Place
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.stability import Gates, StabilitySpec
from vsgdesign.parameters.study import ClosedFormTarget, ControllerSpec, SimulationSpec, Study

POWER_FILTER = 5e-3
"""s, of the power loops that the gains are checked with."""


def angle_damped_target(settling_time: float) -> ClosedFormTarget:
    """The angle-damped closed form, without coupling, at the present references (:eq:`angle-damped-gains`)."""
    k_1, d_1, k_2 = paced(*EQUAL_TIMES, 1.0 / settling_time)
    return ClosedFormTarget(
        settling_time=settling_time,
        damping_ratio=1.0,
        droop_ratio=0.01,
        P=0.0,
        Q=0.0,
        structure=ANGLE_DAMPED.name,
        follow_references=True,
        k_1=k_1,
        d_1=d_1,
        k_2=k_2,
    )


def study_of(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox | None = None,
    *,
    target: ClosedFormTarget | None = None,
    tau: float = POWER_FILTER,
) -> Study:
    """A study with one controller on the box's strongest, least resistive grid and a nominal source.

    ``gains`` in SI, ``omega_t`` in rad/s, ``tau`` in s. Its hash is empty: it is no file's.
    """
    box = box or GridBox()
    target = target or angle_damped_target(1.0)
    c = converter
    return Study(
        name="inner_loops",
        title="inner loops",
        source="",
        converter=c,
        filter=filter_,
        inner_gains=gains,
        grid=Place(box.scr[1], box.x_over_r[1], box.basis).grid(c),
        grid_source=GridSource(c.V_rated_rms, c.omega_n),
        scr_basis=box.basis,
        target=target,
        tau_P=tau,
        tau_Q=tau,
        omega_t=omega_t,
        controllers=(ControllerSpec(name="scheduled", kind="scheduled", target=target),),
        simulation=SimulationSpec(
            duration=1.0,
            bridge="averaged",
            start="steady_state",
            log_interval=c.T_s,
            csv_interval=0.0,
            P_ref=0.0,
            Q_ref=0.0,
        ),
        events=(),
        stability=StabilitySpec(scr=(1.0,), x_over_r=(1.0,), P=(0.0,), Q=(0.0,), errors=(0.0,), gates=Gates()),
        hash="",
    )
