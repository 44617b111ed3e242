"""The files that stages pass on to each other. Each is written completely or not at all."""

from vsgdesign.artifacts.files import provenance
from vsgdesign.artifacts.gain_table import GainTable, TableBase, ValidityBox
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.artifacts.guarded_file import room_for, staged_folder, write_record
from vsgdesign.artifacts.time_series import read_npz, write_csv, write_npz

__all__ = [
    "GainTable",
    "TableBase",
    "ValidityBox",
    "provenance",
    "read_npz",
    "read_table_file",
    "room_for",
    "staged_folder",
    "write_csv",
    "write_npz",
    "write_record",
    "write_table_file",
]
