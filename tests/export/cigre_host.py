"""A host of the IEEE/CIGRE interface by ctypes, with the layout of the structures in 64 bits."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np


class Signal(ctypes.Structure):
    _fields_ = [
        ("Name", ctypes.c_char_p),
        ("Description", ctypes.c_char_p),
        ("Unit", ctypes.c_char_p),
        ("DataType", ctypes.c_int32),
        ("Width", ctypes.c_int32),
    ]


class Parameter(ctypes.Structure):
    _fields_ = [
        ("Name", ctypes.c_char_p),
        ("GroupName", ctypes.c_char_p),
        ("Description", ctypes.c_char_p),
        ("Unit", ctypes.c_char_p),
        ("DataType", ctypes.c_int32),
        ("FixedValue", ctypes.c_int32),
        ("Default", ctypes.c_double),
        ("Min", ctypes.c_double),
        ("Max", ctypes.c_double),
    ]


class Info(ctypes.Structure):
    _fields_ = [
        ("Version", ctypes.c_uint8 * 4),
        *((f"text_{k}", ctypes.c_char_p) for k in range(10)),
        ("FixedStepBaseSampleTime", ctypes.c_double),
        ("EMT_RMS_Mode", ctypes.c_uint8),
        ("NumInputPorts", ctypes.c_int32),
        ("InputPortsInfo", ctypes.POINTER(Signal)),
        ("NumOutputPorts", ctypes.c_int32),
        ("OutputPortsInfo", ctypes.POINTER(Signal)),
        ("NumParameters", ctypes.c_int32),
        ("ParametersInfo", ctypes.POINTER(Parameter)),
        ("NumIntStates", ctypes.c_int32),
        ("NumFloatStates", ctypes.c_int32),
        ("NumDoubleStates", ctypes.c_int32),
    ]


class InstanceData(ctypes.Structure):
    _fields_ = [
        ("ExternalInputs", ctypes.c_void_p),
        ("ExternalOutputs", ctypes.c_void_p),
        ("Parameters", ctypes.c_void_p),
        ("Time", ctypes.c_double),
        ("SimTool_EMT_RMS_Mode", ctypes.c_uint8),
        ("LastErrorMessage", ctypes.c_char_p),
        ("LastGeneralMessage", ctypes.c_char_p),
        ("IntStates", ctypes.c_void_p),
        ("FloatStates", ctypes.c_void_p),
        ("DoubleStates", ctypes.c_void_p),
    ]


class Dll:
    """A loaded library."""

    def __init__(self, place: Path) -> None:
        self.library = ctypes.CDLL(str(place))
        self.library.Model_GetInfo.restype = ctypes.POINTER(Info)
        self.info: Any = self.library.Model_GetInfo().contents
        self.inputs = [self.info.InputPortsInfo[k] for k in range(self.info.NumInputPorts)]
        self.outputs = [self.info.OutputPortsInfo[k] for k in range(self.info.NumOutputPorts)]
        self.parameters = [self.info.ParametersInfo[k] for k in range(self.info.NumParameters)]


class Hosted:
    """One instance, called as importers do: once at a sample, with Model_Initialize up to a time of release."""

    def __init__(self, dll: Dll, release_s: float = -1.0, **parameters: float) -> None:
        self.dll, self.release_s, self.k = dll, release_s, 0
        self.inputs = np.zeros(len(dll.inputs))
        self.outputs = np.zeros(len(dll.outputs))
        self.parameters = np.array(
            [parameters.get(one.Name.decode(), one.Default) for one in dll.parameters], dtype=float
        )
        self.states = np.zeros(dll.info.NumDoubleStates)
        self.data = InstanceData(
            ExternalInputs=self.inputs.ctypes.data,
            ExternalOutputs=self.outputs.ctypes.data,
            Parameters=self.parameters.ctypes.data,
            SimTool_EMT_RMS_Mode=1,
            DoubleStates=self.states.ctypes.data,
        )

    def call(self, name: str) -> int:
        """A function of the interface."""
        return int(getattr(self.dll.library, f"Model_{name}")(ctypes.byref(self.data)))

    def sample(self, given: np.ndarray, time_s: float, first_outputs: np.ndarray | None = None) -> np.ndarray:
        """Everything that happens at a sample."""
        self.inputs[:] = given
        self.data.Time = time_s
        if self.k == 0:
            assert self.call("FirstCall") == 0
        if time_s == 0.0:
            assert self.call("CheckParameters") == 0, self.data.LastErrorMessage
        if time_s <= self.release_s:
            if first_outputs is not None:
                self.outputs[:] = first_outputs
            assert self.call("Initialize") == 0
        assert self.call("Outputs") == 0, self.data.LastErrorMessage
        self.k += 1
        return self.outputs.copy()
