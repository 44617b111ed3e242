"""Types of the public names, for editors and type checkers; they are loaded when they are used."""

from vsgdesign.errors import VsgDesignError as VsgDesignError
from vsgdesign.metrics.recorded import step_figures as step_figures
from vsgdesign.runtime.scheduler import load_scheduler as load_scheduler
from vsgdesign.study.parameters.loading import case_names as case_names
from vsgdesign.study.parameters.study import Study as Study
from vsgdesign.verbs.facade.assessed import Margins as Margins
from vsgdesign.verbs.facade.assessed import margins as margins
from vsgdesign.verbs.facade.exports import export_all as export_all
from vsgdesign.verbs.facade.exports import export_dll as export_dll
from vsgdesign.verbs.facade.exports import export_firmware as export_firmware
from vsgdesign.verbs.facade.exports import export_fmu as export_fmu
from vsgdesign.verbs.facade.exports import export_modelica as export_modelica
from vsgdesign.verbs.facade.exports import export_plecs as export_plecs
from vsgdesign.verbs.facade.exports import export_simulink as export_simulink
from vsgdesign.verbs.facade.linear import linear_model as linear_model
from vsgdesign.verbs.facade.reporting import explore as explore
from vsgdesign.verbs.facade.reporting import write_report as write_report
from vsgdesign.verbs.facade.simulated import Run as Run
from vsgdesign.verbs.facade.simulated import simulate as simulate
from vsgdesign.verbs.facade.studies import controller as controller
from vsgdesign.verbs.facade.studies import event as event
from vsgdesign.verbs.facade.studies import grid as grid
from vsgdesign.verbs.facade.studies import load as load
from vsgdesign.verbs.facade.tables import DesignedTable as DesignedTable
from vsgdesign.verbs.facade.tables import Proof as Proof
from vsgdesign.verbs.facade.tables import certify as certify
from vsgdesign.verbs.facade.tables import design_table as design_table
from vsgdesign.verbs.facade.tables import export_c as export_c
from vsgdesign.verbs.facade.tables import open_table as open_table

__all__: list[str]
__version__: str
