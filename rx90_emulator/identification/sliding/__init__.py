"""The sliding regime, tau_c, tau_s, omega_s, delta and c2, from sweeps at constant velocity."""
