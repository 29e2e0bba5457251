"""Vectors, poses and velocities in the plane; components are arrays of one shape."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Vec:
    """A vector [m, or m/s]; `x` and `y` have one shape."""

    x: jax.Array
    y: jax.Array

    def __getitem__(self, place: Any) -> "Vec":
        """The vectors at some indices, as of an array."""
        return Vec(self.x[place], self.y[place])

    def __add__(self, other: "Vec") -> "Vec":
        """The sum."""
        return Vec(self.x + other.x, self.y + other.y)

    def __sub__(self, other: "Vec") -> "Vec":
        """The difference."""
        return Vec(self.x - other.x, self.y - other.y)

    def __neg__(self) -> "Vec":
        """The opposite."""
        return Vec(-self.x, -self.y)

    def __mul__(self, factor: jax.Array | float) -> "Vec":
        """The vector times a number."""
        return Vec(self.x * factor, self.y * factor)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pose:
    """A body's pose: its centre of mass [m], and cosine and sine of its angle."""

    place: Vec
    cos: jax.Array
    sin: jax.Array

    def world_vector(self, local: Vec) -> Vec:
        """A vector of the body's frame, in the world."""
        return Vec(self.cos * local.x - self.sin * local.y, self.sin * local.x + self.cos * local.y)

    def world_point(self, local: Vec) -> Vec:
        """A point of the body's frame, in the world."""
        return self.world_vector(local) + self.place

    def local_point(self, point: Vec) -> Vec:
        """A point of the world, in the body's frame."""
        away = point - self.place
        return Vec(self.cos * away.x + self.sin * away.y, self.cos * away.y - self.sin * away.x)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Speeds:
    """Velocities of one body or several, arrays of one shape.

    Attributes:
        velocity: of the centre of mass [m/s].
        spin: angular velocity [rad/s].
    """

    velocity: Vec
    spin: jax.Array


def pose(place: Vec, angle: jax.Array) -> Pose:
    """The pose of a body from its centre of mass and its angle [rad]."""
    return Pose(place, jnp.cos(angle), jnp.sin(angle))


def vec(values: np.ndarray, trailing: int = 0) -> Vec:
    """Constant vectors from an array.

    Args:
        values: components on the last axis.
        trailing: number of axes of length 1 that are added at the end.

    Returns:
        The vectors, float32.
    """
    shape = (*values.shape[:-1], *[1] * trailing)
    x, y = (jnp.asarray(values[..., axis], jnp.float32).reshape(shape) for axis in range(2))
    return Vec(x, y)


def dot(a: Vec, b: Vec) -> jax.Array:
    """The scalar product."""
    return a.x * b.x + a.y * b.y


def cross(a: Vec, b: Vec) -> jax.Array:
    """The third component of the vector product."""
    return a.x * b.y - a.y * b.x


def tangent(normal: Vec) -> Vec:
    """A normal turned clockwise by a quarter."""
    return Vec(normal.y, -normal.x)


def where(condition: jax.Array, a: Vec, b: Vec) -> Vec:
    """A choice, component by component."""
    return Vec(jnp.where(condition, a.x, b.x), jnp.where(condition, a.y, b.y))
