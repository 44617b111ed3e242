"""A study whose dc link has a source: one of each kind."""

STUDY = """
base = "case:lab_12kva_lcl"
study = {{ name = "fed" }}
grid = {{ scr_basis = "impedance", scr = 5, x_over_r = 3 }}
power_loops = {{ structure = "angle_damped", P_droop = 0.05, Q_droop = 0.5 }}
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
simulation = {{ duration = 1.0, P_ref = 4000, Q_ref = 0 }}
[[controllers]]
name = "fixed"
kind = "fixed"
[[controllers]]
name = "followed"
kind = "scheduled"
{dc}
"""
SOURCES = {
    "battery": '[dc]\nsource = "battery"\nC = 4e-4\n[dc.battery]\nR_i = 0.3\ni_max = 25\ncapacity_Ah = 10\n',
    "converter": (
        '[dc]\nsource = "converter"\nC = 1e-3\nR_bleed = 5e4\n'
        "[dc.converter]\np_max = 8e3\np_charge_max = 8e3\nenergy = 5e4\nfeed_forward = 0.5\nk_p = 100\n"
    ),
    "photovoltaic": '[dc]\nsource = "photovoltaic"\nC = 1e-3\n[dc.photovoltaic]\nmodules = 13\nstrings = 5\n',
    "clamped": (
        '[dc]\nsource = "battery"\nC = 1e-3\ncontrol = "power_clamp"\n'
        "[dc.battery]\nR_i = 0.3\ni_max = 10\ncapacity_Ah = 10\n"
    ),
}
