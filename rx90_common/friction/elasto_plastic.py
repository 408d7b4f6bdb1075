"""Elasto-plastic bristles: purely elastic up to break-away, so that a load oscillating below it causes no drift.

Dupont, Hayward, Armstrong, Altpeter, "Single state elastoplastic friction models", IEEE Transactions on Automatic
Control 47 (2002). With s = sgn(v), the steady deflection g(v) of equation 19 and the deflection y = s z in the sense of
the velocity,

    dz/dt = v (1 - alpha(y, v) y / g(v)),    tau_f = c0 z + c1(v) dz/dt + viscous torque,
    alpha = 0                                                      y <= z_ba: elastic, also where z opposes v
    alpha = 1/2 + 1/2 sin(pi (y - (g + z_ba) / 2) / (g - z_ba))    z_ba < y < g
    alpha = 1                                                      y >= g: LuGre

This alpha is the paper's; it has nothing to do with the viscous exponent. The break-away deflection is z_ba =
break_away tau_c / c0, with the tau_c of the sign of v: a constant below every g(v), as published.

**The step is exact for a constant velocity.** Time enters only as the travel |v| dt, and a step passes at most two
of three branches, because y grows with the travel up to g and stays beyond g if it began there:

- elastic, y = y0 + travel, until z_ba;
- from z_ba on, with y = g - (g - z_ba) n, sharpness b = g / (g - z_ba) and n = n0 exp(-u), the equation becomes
  du / dx = r(n) in the travel x over g, where r(n) = 1 + n a(n) and a(n) = (b - n) (sin(pi n / 2) / n)^2. As r >= 1, a
  trajectory never passes g. Integrated,

      x = u - (integral of a / r from n0 exp(-u) to n0),

  whose integrand is smooth, also at n = 0. Gauss's rule with 16 nodes computes it to 1e-9 over the whole branch, and
  far better over the part that a step covers; Newton's method solves for u. The mean deflection is an integral of 1 /
  r;
- LuGre's exponential beyond g, and within 1e-8 of it, where both agree to rounding.

At v = 0 the deflection keeps its bits. No step length is unstable: the deflection never exceeds its bound.

**Passivity.** With the stored energy c0 z^2 / 2 the dissipated power is c0 g |v| alpha w^2 + c1 v^2 (1 - alpha w) +
viscous, w = y / g. For w <= 1 it is never negative. Beyond, where alpha is 1, it is LuGre's: the same bound of c1,
c1 |v| < 4 c0 g(v), is sufficient.
"""

from __future__ import annotations

from typing import Any

from rx90_common.friction.bristle import damping, decay, sliding_torque, viscous_torque
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential, exponential_less_one, sine_cosine
from rx90_common.kernels.lanes import Number, absolute, any_lane, fma, select

# Gauss and Legendre's rule of 16 nodes: the positive ones and their weights.
_NODES = (
    0.09501250983763744,
    0.2816035507792589,
    0.45801677765722737,
    0.6178762444026438,
    0.755404408355003,
    0.8656312023878318,
    0.9445750230732326,
    0.9894009349916499,
)
_WEIGHTS = (
    0.1894506104550685,
    0.18260341504492358,
    0.16915651939500254,
    0.14959598881657674,
    0.12462897125553388,
    0.09515851168249279,
    0.062253523938647894,
    0.027152459411754096,
)
_MAP = 0.3  # the integration variable is n / (n + _MAP), which has more nodes at small n, where the integrands bend
_SETTLED = 1e-8  # of the way from break-away to steady sliding: nearer, LuGre's exponential is exact to rounding
_LEAST = 1e-300  # of n = n0 exp(-u): 0 would be divided by
_HALF_PI = 1.5707963267948966
_CLOSE = 1e-8  # relative correction after which Newton's next one is below rounding
_MAX_CORRECTIONS = 30


@kernel
def elasto_plastic_torque(element: Any, break_away: Number, z: Number, velocity: Number) -> Number:
    """Return the friction torque at one instant, Nm; arguments as those of `elasto_plastic_step`."""
    forward = velocity >= 0.0
    steady, elastic = _steady_and_break_away(element, break_away, velocity)
    y = select(forward, z, -z)
    n = (steady - y) / (steady - elastic)
    between = select(n > 0.0, select(n < 1.0, n, 1.0), 0.0)
    _, cosine = sine_cosine(_HALF_PI * between)  # the paper's (1 + sin(...)) / 2 is its square
    plastic = select(y > elastic, cosine * cosine, 0.0)
    z_dot = velocity * (1.0 - plastic * y / steady)
    bristle: Number = element.c0 * z + damping(element, velocity) * z_dot
    return bristle + viscous_torque(element, velocity)


@kernel
def elasto_plastic_step(
    element: Any, break_away: Number, z: Number, velocity: Number, step: float
) -> tuple[Number, Number]:
    """Advance the deflection by `step` seconds at constant velocity; numbers, or lanes of several elements.

    Args:
        element: an `Elements` of rx90_common.friction.bristle.
        break_away: purely elastic deflection in parts of tau_c / c0.
        z: deflection, rad.
        velocity: rad/s.
        step: s.

    Returns:
        The new deflection, rad, and the mean friction torque over the step, Nm.
    """
    forward = velocity >= 0.0
    steady, elastic = _steady_and_break_away(element, break_away, velocity)
    y = select(forward, z, -z)
    travel = absolute(velocity) * step
    room = elastic - y
    loaded = select(room > 0.0, select(room < travel, room, travel), 0.0)
    y1 = y + loaded
    left = (travel - loaded) / steady
    gain, lacking = _beyond(steady, elastic, y1, left)
    share = select(travel > 0.0, loaded / travel, 1.0)
    mean_y = share * (y + 0.5 * loaded) + (1.0 - share) * (steady - lacking)
    moved = loaded + gain
    mean_z = select(travel > 0.0, select(forward, mean_y, -mean_y), z)
    z_dot = select(forward, moved, -moved) / step
    torque = (
        element.c0 * mean_z + damping(element, velocity) * z_dot + viscous_torque(element, velocity)
    )
    return select(forward, y + moved, -(y + moved)), torque


@inlined
def _steady_and_break_away(
    element: Any, break_away: Number, velocity: Number
) -> tuple[Number, Number]:
    """Return the deflections of steady sliding, g(v), and of break-away, rad, in the sense of the velocity."""
    coulomb = select(velocity >= 0.0, element.tau_c[0], element.tau_c[1])
    return sliding_torque(element, velocity) / element.c0, break_away * coulomb / element.c0


@inlined
def _beyond(steady: Number, elastic: Number, y: Number, left: Number) -> tuple[Number, Number]:
    """Return the growth of a deflection beyond break-away, and the mean of its distance from the steady one, rad.

    Args:
        steady: deflection of steady sliding, rad.
        elastic: of break-away, rad.
        y: at the start, rad.
        left: remaining travel over the steady deflection.
    """
    span = steady - elastic
    rest = steady - y
    phi, psi = decay(left)
    gain = rest * left * phi
    mean = rest * (1.0 - left * psi)
    n = rest / span
    curved = select(n > _SETTLED, left, 0.0)
    inside = curved > 0.0
    if any_lane(inside):
        grown, lacking = _transition(select(n < 1.0, n, 1.0), curved, steady / span)
        gain = select(inside, span * grown, gain)
        mean = select(inside, span * lacking, mean)
    return gain, mean


@inlined
def _transition(n0: Number, travel: Number, sharpness: Number) -> tuple[Number, Number]:
    """Return n0 - n after the travel, and the mean of n over it; NaN in lanes without travel.

    Newton's method starts on the far side, where the function is nearly straight. A lane that has converged is left
    alone, so that it does not depend on its neighbours.
    """
    u = travel * (1.0 + n0 * _bend(n0, sharpness))
    moving = 1.0 + 0.0 * u
    mean = 0.0 * u
    for _ in range(_MAX_CORRECTIONS):
        after = n0 * exponential(-u)
        after = select(after < _LEAST, _LEAST, after)
        shortfall, inverse = _integrals(n0, after, -n0 * exponential_less_one(-u), sharpness)
        rate = 1.0 + after * _bend(after, sharpness)
        correction = (u - shortfall - travel) * rate
        active = moving > 0.0
        mean = select(active, (inverse - correction * after / rate) / travel, mean)
        moving = select(absolute(correction) > _CLOSE * u, moving, 0.0)
        u = select(active, u - correction, u)
        if not any_lane(moving > 0.0):
            break
    return -n0 * exponential_less_one(-u), mean


@inlined
def _bend(n: Number, sharpness: Number) -> Number:
    """Return a(n) > 0."""
    sine, _ = sine_cosine(_HALF_PI * n)
    ratio = sine / n
    return ratio * ratio * (sharpness - n)


@inlined
def _integrals(n0: Number, n1: Number, width: Number, sharpness: Number) -> tuple[Number, Number]:
    """Return the integrals of a / r and of 1 / r from n1 to n0 > n1, whose difference is `width`."""
    end = (1.0 + _MAP) * n0 / (n0 + _MAP)
    half = 0.5 * (1.0 + _MAP) * _MAP * width / ((n0 + _MAP) * (n1 + _MAP))
    shortfall = 0.0 * n0
    inverse = 0.0 * n0
    for k in range(len(_NODES)):
        for sign in (-1.0, 1.0):
            place = fma(half, sign * _NODES[k] - 1.0, end)
            back = 1.0 / (1.0 + _MAP - place)
            n = _MAP * place * back
            bend = _bend(n, sharpness)
            weight = _WEIGHTS[k] * back * back / (1.0 + n * bend)
            shortfall = fma(weight, bend, shortfall)
            inverse = inverse + weight
    scale = half * _MAP * (1.0 + _MAP)
    return scale * shortfall, scale * inverse
