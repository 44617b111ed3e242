"""What stages hand over as files, and how they are written: whole, or not at all."""

from vsgdesign.artifacts.files import staged_folder, write_json
from vsgdesign.artifacts.provenance import provenance
from vsgdesign.artifacts.time_series import read_npz, write_csv, write_npz

__all__ = ["provenance", "read_npz", "staged_folder", "write_csv", "write_json", "write_npz"]
