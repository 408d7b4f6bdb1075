"""Blocks of a drives file for six joints that the shipped ones leave out."""

DRIVE_BLOCKS = {
    "elasticity": {
        "stiffness": [1.5e6, 1.5e6, 5.0e5, 1.0e5, 6.0e4, 3.0e4], "damping": [300.0, 300.0, 100.0, 20.0, 12.0, 6.0],
        "backlash": [1.0e-4, 1.0e-4, 1.0e-4, 2.0e-4, 2.0e-4, 2.0e-4], "friction": "motor",
    },
    "cogging": {
        "harmonic": [6.0, 36.0], "phase": [[0.0] * 6] * 2,
        "amplitude": [[0.03, 0.03, 0.02, 0.01, 0.01, 0.01], [0.01, 0.01, 0.01, 0.005, 0.005, 0.005]],
    },
    "winding": {
        "resistance": [2.0] * 6, "thermal_resistance": [20.0] * 6, "heat_capacity": [3.0] * 6,
        "ambient": 25.0, "initial": 100.0, "derating": 100.0, "limit": 140.0, "reference": 20.0, "coefficient": 0.0,
    },
    "current_sensor": {
        "offset": [0.01, -0.01, 0.005, 0.0, 0.005, 0.0], "noise": [0.01, 0.01, 0.01, 0.005, 0.005, 0.005],
        "resolution": [0.01, 0.01, 0.005, 0.005, 0.005, 0.005], "bandwidth": 800.0,
    },
}  # fmt: skip
