"""Types of the public names, for editors and type checkers; they are loaded when they are used."""

from vsgdesign.errors import VsgDesignError as VsgDesignError
from vsgdesign.facade.assessed import Margins as Margins
from vsgdesign.facade.assessed import margins as margins
from vsgdesign.facade.reporting import write_report as write_report
from vsgdesign.facade.simulated import Run as Run
from vsgdesign.facade.simulated import simulate as simulate
from vsgdesign.facade.studies import controller as controller
from vsgdesign.facade.studies import event as event
from vsgdesign.facade.studies import grid as grid
from vsgdesign.facade.studies import load as load
from vsgdesign.facade.tables import DesignedTable as DesignedTable
from vsgdesign.facade.tables import Proof as Proof
from vsgdesign.facade.tables import certify as certify
from vsgdesign.facade.tables import design_table as design_table
from vsgdesign.facade.tables import export_c as export_c
from vsgdesign.facade.tables import open_table as open_table
from vsgdesign.parameters.loading import case_names as case_names
from vsgdesign.parameters.study import Study as Study
from vsgdesign.runtime.scheduler import load_scheduler as load_scheduler

__all__: list[str]
__version__: str
