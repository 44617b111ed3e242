"""Inner gains that ``design_inner_loops`` found for the packaged converters (seed 0, SCR 1.3 to 20 × X/R 0.3 to 20).

Six digits: what is asked of them must not hang on the seventh. Made anew by ``design_inner_loops(converter, filter_,
GridBox())`` for every case.
"""

from __future__ import annotations

from vsgdesign.equations.inner_loops import InnerLoopGains

DESIGNED = {
    "article_10kva_lc_4khz": (
        InnerLoopGains(0.232802, 71.9819, 3.4101, 65.6474, -0.48529, 0.263998, 0.293346, 1.63021),
        37.7579,
        0.658,
    ),
    "darco2015_2750kva": (
        InnerLoopGains(2.9023, 3169.05, 0.366928, 9.92193, 0.148615, 0.00544648, 0.0163027, 1.22763),
        81.6806,
        0.553,
    ),
    "hoang2025_5kva": (
        InnerLoopGains(0.19311, 87.8129, 10.3242, 338.206, 0.575858, 0.0196684, 1.82866, 0.0),
        339.762,
        1.289,
    ),
    "lab_12kva_lcl": (
        InnerLoopGains(0.0541822, 28.4352, 22.7746, 824.657, 0.773381, 2.47757, 2.57681, 1.43099),
        225.447,
        1.428,
    ),
    "microgrid_gym_3kva_60hz": (
        InnerLoopGains(0.0892012, 62.9335, 7.43502, 287.673, -0.754014, 0.0148435, 0.749752, 1.35753),
        51.2012,
        0.57,
    ),
    "motulator_10kva_lcl": (
        InnerLoopGains(0.0509412, 15.0671, 21.9202, 607.753, 0.599718, 0.982967, 1.25685, 1.42336),
        77.744,
        1.062,
    ),
    "pogaku2007_10kva": (
        InnerLoopGains(0.170281, 32.2998, 6.60007, 208.147, 0.478202, 0.130102, 0.370496, 1.37689),
        52.1569,
        1.063,
    ),
    "simplus_100kva": (
        InnerLoopGains(0.235273, 478.033, 4.76344, 135.9, 0.355056, 0.118724, 0.208234, 1.22178),
        179.098,
        0.719,
    ),
    "sized_100kva_no_delay": (
        InnerLoopGains(0.223367, 401.587, 3.88306, 116.482, 0.618653, 0.114374, 0.548367, 0.0),
        397.433,
        1.166,
    ),
    "sized_125kva_480v_60hz": (
        InnerLoopGains(0.308867, 491.579, 3.99511, 151.181, 0.780123, 0.363282, 0.341357, 1.35919),
        326.209,
        1.209,
    ),
    "sized_1kva_208v_60hz": (
        InnerLoopGains(0.0284075, 10.9903, 38.4176, 1417.04, 0.400869, 0.128869, 1.88323, 1.43397),
        72.0129,
        0.949,
    ),
    "sized_250kva_480v_60hz": (
        InnerLoopGains(7.56783, 257.889, 0.1277, 87.0056, 0.536921, 0.825912, -0.155175, 1.9253),
        975.913,
        0.434,
    ),
    "sized_30kva_sic": (
        InnerLoopGains(0.114389, 220.088, 10.839, 422.172, 0.781405, 1.02103, 0.966237, 1.35876),
        278.81,
        1.173,
    ),
    "sized_500kva_storage": (
        InnerLoopGains(2.5272, 820.267, 0.424505, 9.72575, 0.340891, 0.00776996, 0.0130025, 1.42653),
        39.7048,
        0.827,
    ),
    "sized_50kva_208v_60hz": (
        InnerLoopGains(0.521353, 1189.33, 2.06183, 77.6298, 0.638614, 0.100209, 0.296634, 0.0),
        495.256,
        1.242,
    ),
    "sized_5mva_3300v": (
        InnerLoopGains(2.39977, 139.085, 0.373339, 234.007, 0.26527, 1.83084, -0.326692, 1.96053),
        1176.87,
        0.598,
    ),
    "utility_1mva_60hz": (
        InnerLoopGains(1.40144, 679.794, 0.732502, 18.6312, 0.0847495, 0.00544011, 0.0351746, 1.51801),
        57.1319,
        0.762,
    ),
    "yang2020_1mva": (
        InnerLoopGains(2.52545, 701.825, 0.445213, 454.518, 0.521625, 0.00231438, 0.0413726, 1.36829),
        94.8181,
        1.133,
    ),
}
"""Case: gains (SI), ω_t (rad/s), t on 13 × 13 grids."""

UNSEARCHED: set[str] = set()
"""Packaged cases without stored gains."""
