"""CasADi functions of the equations: exact derivatives, generated rather than written."""

from vsgdesign.linear.model.power_loops import LoopMatrices, decoupled_loops, jacobian, power_flow_function

__all__ = ["LoopMatrices", "decoupled_loops", "jacobian", "power_flow_function"]
