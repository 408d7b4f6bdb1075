"""The rigid arm in compiled code: mass matrix and bias torques of a serial chain of six revolute joints.

Every quantity is expressed in the base frame about the base origin. Spatial inertias then add without any
transformation, which makes the composite-rigid-body algorithm (Featherstone 2008, table 6.2) a running sum.
The constants come from the URDF through Pinocchio; Pinocchio is the oracle in the tests.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.compiled import kernel

MANIPULATOR_DTYPE = np.dtype(
    [
        ("origin", np.float64, (6, 3)),
        ("axis", np.float64, (6, 3)),
        ("mass", np.float64, 6),
        ("com", np.float64, (6, 3)),
        ("inertia", np.float64, (6, 6)),
        ("gravity", np.float64, 3),
        ("rotor", np.float64, (6, 6)),
        ("spring_torque", np.float64),
    ],
    align=True,
)
"""Constants: the chain in frames parallel at the zero pose, gravity, the rotors' inertia, the spring."""

BODY_DTYPE = np.dtype(
    [
        (
            "axis",
            np.float64,
            (6, 6),
        ),  # joint axes as spatial vectors: angular, then linear at the base origin
        ("mass", np.float64, 6),
        ("moment", np.float64, (6, 3)),  # mass times centre of mass
        ("inertia", np.float64, (6, 6)),  # xx, yy, zz, xy, xz, yz about the base origin
        ("force", np.float64, (6, 6)),  # torque about the base origin, then force
    ],
    align=True,
)
"""Workspace of one evaluation, one row per body."""


@kernel
def mass_and_bias(
    arm: Any,
    body: Any,
    q: NDArray[np.float64],
    v: NDArray[np.float64],
    mass_matrix: NDArray[np.float64],
    bias: NDArray[np.float64],
) -> None:
    """Write M(q), shape (6, 6), and h(q, v), shape (6,): M a + h = drive torque - friction torque.

    M includes the rotors with the wrist coupling; h holds Coriolis, centrifugal and gravity torques and the
    gravity-compensation spring.

    Args:
        arm: record of MANIPULATOR_DTYPE.
        body: record of BODY_DTYPE, overwritten.
        q: joint positions, rad, shape (6,).
        v: joint velocities, rad/s, shape (6,).
        mass_matrix: overwritten, kg m^2.
        bias: overwritten, Nm.
    """
    _forward(arm, body, q, v)
    _backward(arm, body, mass_matrix, bias)
    bias[1] += arm.spring_torque * math.sin(q[1])


@kernel
def _forward(arm: Any, body: Any, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
    """Fill `body` with axes, inertias and the forces that the motion at zero joint acceleration needs."""
    # Rotation and origin of the current link, its spatial velocity (w, u) and acceleration (b, d).
    r00, r01, r02 = 1.0, 0.0, 0.0
    r10, r11, r12 = 0.0, 1.0, 0.0
    r20, r21, r22 = 0.0, 0.0, 1.0
    px = py = pz = 0.0
    wx = wy = wz = ux = uy = uz = 0.0
    bx = by = bz = 0.0
    dx, dy, dz = -arm.gravity[0], -arm.gravity[1], -arm.gravity[2]
    for i in range(6):
        ox, oy, oz = arm.origin[i, 0], arm.origin[i, 1], arm.origin[i, 2]
        px += r00 * ox + r01 * oy + r02 * oz
        py += r10 * ox + r11 * oy + r12 * oz
        pz += r20 * ox + r21 * oy + r22 * oz

        # The joint axis as a spatial vector (a, e), and what a unit of joint velocity adds.
        kx, ky, kz = arm.axis[i, 0], arm.axis[i, 1], arm.axis[i, 2]
        ax = r00 * kx + r01 * ky + r02 * kz
        ay = r10 * kx + r11 * ky + r12 * kz
        az = r20 * kx + r21 * ky + r22 * kz
        ex, ey, ez = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
        rate = v[i]
        bx += rate * (wy * az - wz * ay)
        by += rate * (wz * ax - wx * az)
        bz += rate * (wx * ay - wy * ax)
        dx += rate * (wy * ez - wz * ey + uy * az - uz * ay)
        dy += rate * (wz * ex - wx * ez + uz * ax - ux * az)
        dz += rate * (wx * ey - wy * ex + ux * ay - uy * ax)
        wx += rate * ax
        wy += rate * ay
        wz += rate * az
        ux += rate * ex
        uy += rate * ey
        uz += rate * ez

        # R <- R Rot(k, q), Rodrigues' formula.
        c, s = math.cos(q[i]), math.sin(q[i])
        t = 1.0 - c
        m00, m01, m02 = c + t * kx * kx, t * kx * ky - s * kz, t * kx * kz + s * ky
        m10, m11, m12 = t * kx * ky + s * kz, c + t * ky * ky, t * ky * kz - s * kx
        m20, m21, m22 = t * kx * kz - s * ky, t * ky * kz + s * kx, c + t * kz * kz
        r00, r01, r02 = (
            r00 * m00 + r01 * m10 + r02 * m20,
            r00 * m01 + r01 * m11 + r02 * m21,
            r00 * m02 + r01 * m12 + r02 * m22,
        )
        r10, r11, r12 = (
            r10 * m00 + r11 * m10 + r12 * m20,
            r10 * m01 + r11 * m11 + r12 * m21,
            r10 * m02 + r11 * m12 + r12 * m22,
        )
        r20, r21, r22 = (
            r20 * m00 + r21 * m10 + r22 * m20,
            r20 * m01 + r21 * m11 + r22 * m21,
            r20 * m02 + r21 * m12 + r22 * m22,
        )

        # Inertia in base axes about the centre of mass, then about the base origin.
        gx, gy, gz = arm.com[i, 0], arm.com[i, 1], arm.com[i, 2]
        cx = px + r00 * gx + r01 * gy + r02 * gz
        cy = py + r10 * gx + r11 * gy + r12 * gz
        cz = pz + r20 * gx + r21 * gy + r22 * gz
        mass = arm.mass[i]
        hx, hy, hz = mass * cx, mass * cy, mass * cz
        ixx, iyy, izz = arm.inertia[i, 0], arm.inertia[i, 1], arm.inertia[i, 2]
        ixy, ixz, iyz = arm.inertia[i, 3], arm.inertia[i, 4], arm.inertia[i, 5]
        n00 = r00 * ixx + r01 * ixy + r02 * ixz
        n01 = r00 * ixy + r01 * iyy + r02 * iyz
        n02 = r00 * ixz + r01 * iyz + r02 * izz
        n10 = r10 * ixx + r11 * ixy + r12 * ixz
        n11 = r10 * ixy + r11 * iyy + r12 * iyz
        n12 = r10 * ixz + r11 * iyz + r12 * izz
        n20 = r20 * ixx + r21 * ixy + r22 * ixz
        n21 = r20 * ixy + r21 * iyy + r22 * iyz
        n22 = r20 * ixz + r21 * iyz + r22 * izz
        jxx = n00 * r00 + n01 * r01 + n02 * r02 + hy * cy + hz * cz
        jyy = n10 * r10 + n11 * r11 + n12 * r12 + hx * cx + hz * cz
        jzz = n20 * r20 + n21 * r21 + n22 * r22 + hx * cx + hy * cy
        jxy = n00 * r10 + n01 * r11 + n02 * r12 - hx * cy
        jxz = n00 * r20 + n01 * r21 + n02 * r22 - hx * cz
        jyz = n10 * r20 + n11 * r21 + n12 * r22 - hy * cz

        # Momentum (L, l), then force = I a + velocity x* momentum.
        lx = mass * ux + wy * hz - wz * hy
        ly = mass * uy + wz * hx - wx * hz
        lz = mass * uz + wx * hy - wy * hx
        sx = jxx * wx + jxy * wy + jxz * wz + hy * uz - hz * uy
        sy = jxy * wx + jyy * wy + jyz * wz + hz * ux - hx * uz
        sz = jxz * wx + jyz * wy + jzz * wz + hx * uy - hy * ux
        body.force[i, 0] = jxx * bx + jxy * by + jxz * bz + hy * dz - hz * dy + wy * sz - wz * sy + uy * lz - uz * ly
        body.force[i, 1] = jxy * bx + jyy * by + jyz * bz + hz * dx - hx * dz + wz * sx - wx * sz + uz * lx - ux * lz
        body.force[i, 2] = jxz * bx + jyz * by + jzz * bz + hx * dy - hy * dx + wx * sy - wy * sx + ux * ly - uy * lx
        body.force[i, 3] = mass * dx + by * hz - bz * hy + wy * lz - wz * ly
        body.force[i, 4] = mass * dy + bz * hx - bx * hz + wz * lx - wx * lz
        body.force[i, 5] = mass * dz + bx * hy - by * hx + wx * ly - wy * lx

        body.axis[i, 0], body.axis[i, 1], body.axis[i, 2] = ax, ay, az
        body.axis[i, 3], body.axis[i, 4], body.axis[i, 5] = ex, ey, ez
        body.mass[i] = mass
        body.moment[i, 0], body.moment[i, 1], body.moment[i, 2] = hx, hy, hz
        body.inertia[i, 0], body.inertia[i, 1], body.inertia[i, 2] = jxx, jyy, jzz
        body.inertia[i, 3], body.inertia[i, 4], body.inertia[i, 5] = jxy, jxz, jyz


@kernel
def _backward(arm: Any, body: Any, mass_matrix: NDArray[np.float64], bias: NDArray[np.float64]) -> None:
    """Sum inertias and forces from the tip and project them on the joint axes."""
    mass = hx = hy = hz = jxx = jyy = jzz = jxy = jxz = jyz = 0.0
    tx = ty = tz = fx = fy = fz = 0.0
    for i in range(5, -1, -1):
        mass += body.mass[i]
        hx += body.moment[i, 0]
        hy += body.moment[i, 1]
        hz += body.moment[i, 2]
        jxx += body.inertia[i, 0]
        jyy += body.inertia[i, 1]
        jzz += body.inertia[i, 2]
        jxy += body.inertia[i, 3]
        jxz += body.inertia[i, 4]
        jyz += body.inertia[i, 5]
        tx += body.force[i, 0]
        ty += body.force[i, 1]
        tz += body.force[i, 2]
        fx += body.force[i, 3]
        fy += body.force[i, 4]
        fz += body.force[i, 5]
        ax, ay, az = body.axis[i, 0], body.axis[i, 1], body.axis[i, 2]
        ex, ey, ez = body.axis[i, 3], body.axis[i, 4], body.axis[i, 5]
        bias[i] = ax * tx + ay * ty + az * tz + ex * fx + ey * fy + ez * fz

        # The momentum of all that joint i moves, for a unit of its velocity.
        nx = jxx * ax + jxy * ay + jxz * az + hy * ez - hz * ey
        ny = jxy * ax + jyy * ay + jyz * az + hz * ex - hx * ez
        nz = jxz * ax + jyz * ay + jzz * az + hx * ey - hy * ex
        lx = mass * ex + ay * hz - az * hy
        ly = mass * ey + az * hx - ax * hz
        lz = mass * ez + ax * hy - ay * hx
        for j in range(i + 1):
            entry = (
                arm.rotor[i, j]
                + body.axis[j, 0] * nx
                + body.axis[j, 1] * ny
                + body.axis[j, 2] * nz
                + body.axis[j, 3] * lx
                + body.axis[j, 4] * ly
                + body.axis[j, 5] * lz
            )
            mass_matrix[i, j] = entry
            mass_matrix[j, i] = entry


@kernel
def factorise(mass_matrix: NDArray[np.float64], factor: NDArray[np.float64]) -> None:
    """Write the Cholesky factor of a mass matrix, shape (6, 6): L below, 1 / L_ii on the diagonal."""
    for j in range(6):
        pivot = mass_matrix[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        inverse = 1.0 / math.sqrt(pivot)
        factor[j, j] = inverse
        for i in range(j + 1, 6):
            entry = mass_matrix[i, j]
            for k in range(j):
                entry -= factor[i, k] * factor[j, k]
            factor[i, j] = entry * inverse


@kernel
def solve(factor: NDArray[np.float64], x: NDArray[np.float64]) -> None:
    """Solve M x = b in place for the factor written by `factorise`; `x` holds b, shape (6,)."""
    for i in range(6):
        total = x[i]
        for k in range(i):
            total -= factor[i, k] * x[k]
        x[i] = total * factor[i, i]
    for i in range(5, -1, -1):
        total = x[i]
        for k in range(i + 1, 6):
            total -= factor[k, i] * x[k]
        x[i] = total * factor[i, i]
