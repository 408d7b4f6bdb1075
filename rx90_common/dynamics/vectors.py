"""Vectors of three lanes each: one vector per link of the arm, all links at once."""

from __future__ import annotations

from typing import TypeAlias

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, delay, first, fma, lane, load, prefix_sum, suffix_sum

Vector: TypeAlias = tuple[Lanes, Lanes, Lanes]


@inlined
def load_vectors(rows: Array) -> Vector:
    """Return the vectors of six links from an array of shape (3, 6)."""
    return load(rows[0], 6), load(rows[1], 6), load(rows[2], 6)


@inlined
def first_links(a: Vector) -> Vector:
    """Return the vectors of the first four links."""
    return first(a[0], 4), first(a[1], 4), first(a[2], 4)


@inlined
def scale(factor: Lanes, a: Vector) -> Vector:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def add_scaled(a: Vector, factor: Lanes, b: Vector) -> Vector:
    """Return a + factor b."""
    return fma(factor, b[0], a[0]), fma(factor, b[1], a[1]), fma(factor, b[2], a[2])


@inlined
def dot(a: Vector, b: Vector) -> Lanes:
    """Return a . b."""
    return fma(a[2], b[2], fma(a[1], b[1], a[0] * b[0]))


@inlined
def add_dot(c: Lanes, a: Vector, b: Vector) -> Lanes:
    """Return c + a . b."""
    return fma(a[2], b[2], fma(a[1], b[1], fma(a[0], b[0], c)))


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (
        fma(a[1], b[2], -(a[2] * b[1])),
        fma(a[2], b[0], -(a[0] * b[2])),
        fma(a[0], b[1], -(a[1] * b[0])),
    )


@inlined
def add_cross(c: Vector, a: Vector, b: Vector) -> Vector:
    """Return c + a x b."""
    return (
        fma(-a[2], b[1], fma(a[1], b[2], c[0])),
        fma(-a[0], b[2], fma(a[2], b[0], c[1])),
        fma(-a[1], b[0], fma(a[0], b[1], c[2])),
    )


@inlined
def product(rows: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """Return the product of a matrix, given by its rows, and a."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


@inlined
def sum_from_base(a: Vector) -> Vector:
    """Return for each link the sum over the links from the first one up to it."""
    return prefix_sum(a[0]), prefix_sum(a[1]), prefix_sum(a[2])


@inlined
def sum_before(start: Array, a: Vector) -> Vector:
    """Return for each link `start`, of shape (3,), plus the sum over the links before it."""
    return (
        delay(prefix_sum(a[0]) + start[0], start[0]),
        delay(prefix_sum(a[1]) + start[1], start[1]),
        delay(prefix_sum(a[2]) + start[2], start[2]),
    )


@inlined
def sum_to_tip(a: Vector) -> Vector:
    """Return for each link the sum over it and the links after it."""
    return suffix_sum(a[0]), suffix_sum(a[1]), suffix_sum(a[2])


@inlined
def of_link(a: Vector, link: int) -> Vector:
    """Return the vector of one link as three floats."""
    return lane(a[0], link), lane(a[1], link), lane(a[2], link)
